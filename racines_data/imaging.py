"""How an image is made of poses: the one protocol that phantom, generators and replay share."""

from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from racines_data.errors import RacinesError

IMAGE_SIZE = 128
"""Height and width of an image, pixels."""


@runtime_checkable
class ImageSource(Protocol):
    """Makes ultrasound images of probe parameters."""

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of (B, 12) float32 parameters.

        The columns are those of `schema.PARAMETERS`, in SI units. Where the data that it was fitted
        on know the phase of the beat, that is a 13th, in [0, 1). `seed` is one integer for the
        batch or (B,) int64, one a sample. A sample's image depends on its own parameters and seed
        alone: not on its place, on its neighbours or on the size of the batch, to the last bit, on
        one machine.
        """
        ...


def check_parameters(
    parameters: Tensor, need_force: bool = False, may_beat: bool = False
) -> Tensor:
    """Return the parameters if they are (B, 12), floating and finite.

    If they `may_beat`, (B, 13) as well, the phase of the beat last.

    Raises:
        RacinesError: wrong shape or type, or NaN or infinity, by column and row.
    """
    from racines_data.schema import PARAMETERS, PHASES

    names, width = (*PARAMETERS, PHASES[0]), parameters.shape[-1]
    known = width == len(PARAMETERS) or (may_beat and width == len(names))
    if parameters.ndim != 2 or not known:
        raise RacinesError(f"parameters have shape {tuple(parameters.shape)}: give (B, 12)")
    if not parameters.is_floating_point():
        raise RacinesError(f"parameters are {parameters.dtype}: give float32, SI units")
    first = 0 if need_force else 6
    bad = ~torch.isfinite(parameters[:, first:])
    if bool(bad.any()):
        row, column = (int(i) for i in bad.nonzero()[0])
        raise RacinesError(
            f"{names[first + column]} of row {row} is not finite: every pose needs numbers"
        )
    return parameters


def conditions_for(parameters: Tensor, phased: bool, name: str) -> Tensor:
    """Return the checked parameters that a generator takes: (B, 12), or (B, 13) if it is `phased`.

    A phase that it does not know is left out.

    Raises:
        RacinesError: as `check_parameters`, and a phase that is missing.
    """
    from racines_data.schema import PARAMETERS

    checked, width = check_parameters(parameters, may_beat=True), len(PARAMETERS)
    if not phased:
        return checked[:, :width]
    if checked.shape[1] == width:
        raise RacinesError(
            f"{name} draws a heart at a phase of its beat: give (B, 13) parameters, the phase last"
        )
    return checked


def check_images(images: Tensor) -> Tensor:
    """Return the images if they are (B, H, W) uint8 that use the 0-255 range.

    Raises:
        RacinesError: wrong type, shape or scale (0-1 floats cast to uint8), or all constant.
    """
    if images.dtype != torch.uint8:
        raise RacinesError(f"images are {images.dtype}: give uint8 gray levels 0-255")
    if images.ndim != 3 or images.shape[-2:] != (IMAGE_SIZE, IMAGE_SIZE):
        raise RacinesError(
            f"images have shape {tuple(images.shape)}: give (B, {IMAGE_SIZE}, {IMAGE_SIZE})"
        )
    darkest, brightest = images.aminmax() if images.numel() else (0, 255)
    if brightest <= 1:
        raise RacinesError("images lie in 0-1: scale them to gray levels 0-255 before uint8")
    if brightest == darkest:
        raise RacinesError("images are constant: nothing was drawn")
    return images
