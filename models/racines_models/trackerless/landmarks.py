"""Places of a sweep that can be told from all around them, found in its images alone.

TUS-REC names twenty a sweep. Here they are corners of the image: the pixels at which the smaller
eigenvalue of the structure tensor is greatest (Shi and Tomasi, Good Features to Track, 1994). They
hang on no estimate, and on no anatomy that only a simulator knows.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from racines_data.imaging import IMAGE_SIZE

COUNT = 20
"""Landmarks of a sweep."""
WINDOW = 7
"""Side, pixels, of the square over which the tensor is averaged."""
APART = 15
"""Side, pixels, of the square in which a landmark is the strongest of its frame."""
RIM = 8
"""Pixels from the image's edges in which none is sought."""


class Landmarks(NamedTuple):
    """L places in the frames of a sweep."""

    frame: Tensor
    """(L,) int64, from 1 on: the first frame is the reference."""
    row: Tensor
    """(L,) int64."""
    column: Tensor
    """(L,) int64."""


def landmarks(images: Tensor, count: int = COUNT) -> Landmarks:
    """Find landmarks in (T, 128, 128) uint8 images: as many in each frame, evenly spread.

    A frame that is asked for more than one gives its strongest, then the next that is no
    neighbour. Where a frame shows nothing the middle of the image stands for it.
    """
    frames = torch.linspace(1, len(images) - 1, count).round().long()
    chosen, asked = frames.unique_consecutive(return_counts=True)
    most = int(asked.max())
    strength = corners(images[chosen])
    peak = strength * (strength == _pooled(max_pool2d, strength, APART))
    values, places = peak.flatten(1).topk(most)
    middle = IMAGE_SIZE // 2 * (IMAGE_SIZE + 1)
    places = torch.where(values > 0, places, middle)
    taken = torch.arange(most).unsqueeze(0) < asked.unsqueeze(1)
    return Landmarks(
        chosen.unsqueeze(1).expand_as(places)[taken],
        places[taken] // IMAGE_SIZE,
        places[taken] % IMAGE_SIZE,
    )


def corners(images: Tensor) -> Tensor:
    """Return the (T, 128, 128) smaller eigenvalue of the structure tensor, 0 along the rim."""
    light = images.double()
    dx, dy = torch.zeros_like(light), torch.zeros_like(light)
    dx[:, :, 1:-1] = (light[:, :, 2:] - light[:, :, :-2]) / 2
    dy[:, 1:-1] = (light[:, 2:] - light[:, :-2]) / 2
    products = torch.stack([dx * dx, dy * dy, dx * dy], 1)
    xx, yy, xy = _pooled(avg_pool2d, products, WINDOW).unbind(1)
    least = (xx + yy) / 2 - (((xx - yy) / 2).square() + xy.square()).sqrt()
    inside = torch.zeros(IMAGE_SIZE, IMAGE_SIZE, dtype=torch.float64)
    inside[RIM:-RIM, RIM:-RIM] = 1.0
    # What rounding leaves of a flat or an edge is no corner.
    return torch.where(least > 1e-6, least, 0.0) * inside


def _pooled(pool: Callable[..., Tensor], x: Tensor, side: int) -> Tensor:
    """Pool over squares of a side, first down and then across, which costs a fraction."""
    return pool(pool(x, (side, 1), 1, (side // 2, 0)), (1, side), 1, (0, side // 2))
