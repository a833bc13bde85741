"""How far frames of one version may differ between processors, as measured.

Floating point differs in the last bit between processors. A beam's sample that lies on the edge
between two voxels to that bit falls to either side, and with it to another scatterer: a speckle
changes by some gray levels. What is baked differs too, by one unit in some of the voxels.
`racines study processors` measures both; docs/validate.md has the figures.
"""

from dataclasses import dataclass

import numpy as np

from racines_data.errors import RacinesError

LEVELS = 48
"""Largest difference of a pixel, gray levels: twice what was measured."""
BEYOND = 32
"""Most pixels of a frame that differ by more than one gray level: four times what was measured."""
SHARE, FRAME = 5e-4, 256
"""Largest share of all pixels that differ at all, eight times what was measured; of a few frames as
many pixels, twice the most that one frame had."""


@dataclass(frozen=True)
class Difference:
    """Two drawings of the same frames."""

    pixels: int
    differing: int  # pixels that differ at all
    beyond: int  # pixels that differ by more than one gray level
    worst: int  # most of these in one frame
    levels: int  # greatest difference of a pixel, gray levels

    @property
    def holds(self) -> bool:
        """Whether two processors may differ so in drawing one version."""
        differing = max(SHARE * self.pixels, FRAME)
        return self.levels <= LEVELS and self.worst <= BEYOND and self.differing <= differing

    def __str__(self) -> str:
        return (
            f"{self.levels} gray level{'' if self.levels == 1 else 's'} at most, "
            f"{self.differing} of {self.pixels} pixels, {self.beyond} by more than one"
        )


def compare(one: np.ndarray, other: np.ndarray) -> Difference:
    """Compare (N, H, W) uint8 frames with another drawing of them.

    Raises:
        RacinesError: other frames, by their shape.
    """
    if one.shape != other.shape:
        raise RacinesError(f"frames of shape {one.shape} cannot be held against {other.shape}")
    apart = np.maximum(one, other) - np.minimum(one, other)  # uint8 does not wrap so
    levels = int(apart.max()) if apart.size else 0
    beyond = (apart > 1).reshape(len(apart), -1).sum(1)
    worst = int(beyond.max()) if len(beyond) else 0
    return Difference(apart.size, int((apart > 0).sum()), int(beyond.sum()), worst, levels)
