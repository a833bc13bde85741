"""What no frame may be taken for: the same frames with what makes them a view destroyed.

A share of real frames recognised says nothing without them: a judge that calls everything A4C
recognises all. Gray levels, speckle and sector shape stay; where things stand does not.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from racines_data.randomness import sample_seeds, uniform
from racines_models.studies.sim_to_real.sectors import sectors

BLOCK = 16
"""Side of the blocks that change places, pixels of 128: a seventh of the sector's depth. Those that
are not whole inside it stay, and with them its outline."""
SEED = 0


def upside_down(images: Tensor) -> Tensor:
    """Return (N, H, W) frames with the apex below."""
    return images.flip(-2)


def mirrored(images: Tensor) -> Tensor:
    """Return frames with left and right exchanged: some laboratories show them so."""
    return images.flip(-1)


def scrambled(images: Tensor, block: int = BLOCK) -> Tensor:
    """Return frames whose blocks inside the sector have changed places, by the frame's number."""
    count, size, _ = images.shape
    side = size // block

    def blocks(x: Tensor) -> Tensor:
        cut = x.view(count, side, block, side, block).transpose(2, 3)
        return cut.reshape(count, side * side, block * block)

    inside = blocks(sectors(images)).all(-1)
    drawn = uniform(sample_seeds(SEED, count), side * side)
    shuffled = blocks(images).clone()
    for frame, places, keys in zip(shuffled, inside, drawn, strict=True):
        at = places.nonzero()[:, 0]
        frame[at] = frame[at[keys[at].argsort()]]
    return shuffled.view(count, side, side, block, block).transpose(2, 3).reshape_as(images)


CONTROLS: dict[str, Callable[[Tensor], Tensor]] = {
    "as they are": torch.clone,
    "upside down": upside_down,
    "scrambled": scrambled,
    "mirrored": mirrored,
}
"""In which ways the frames are shown to the grader, by name."""
