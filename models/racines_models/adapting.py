"""Generators that meet a patient: their scout, what may be wrong with it, and who ignores it."""

from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource, check_images, check_parameters
from racines_models.protocol import Adapting


def adapted(generator: ImageSource, images: Tensor, parameters: Tensor, seed: int) -> ImageSource:
    """Return a generator adapted to a patient's scout; itself, if it ignores the patient.

    Args:
        generator: of any kind; one with `adapt` (see `Adapting`) is asked.
        images: (S, 128, 128) uint8 frames of the scout.
        parameters: (S, 12) of the probe.
        seed: of all chance in adapting.

    Raises:
        RacinesError: a scout that cannot be adapted to (see `check_scout`).
    """
    if not isinstance(generator, Adapting):
        return generator
    return generator.adapt(images, parameters, seed)


def check_scout(images: Tensor, parameters: Tensor, least: int, name: str) -> None:
    """Refuse a scout that `name` cannot adapt to, which needs `least` frames.

    Raises:
        RacinesError: too few frames, not one pose a frame, or bad images or poses.
    """
    if len(images) != len(parameters):
        raise RacinesError(
            f"{name}: the scout has {len(images)} images and {len(parameters)} poses: give a pose "
            "for each frame"
        )
    if len(images) < least:
        raise RacinesError(
            f"{name}: the scout has {len(images)} frames and adapt needs {least}: scan on"
        )
    check_images(images)
    check_parameters(parameters)
