"""Differentiable augmentation: random changes that gradients pass through, one a sample's seed.

Source: Zhao et al., Differentiable Augmentation for Data-Efficient GAN Training, 2020.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from racines_data.randomness import uniform

STREAM = 41
"""Random stream of the changes."""
SHIFT = 1 / 8
"""Largest shift, as a share of the side."""
HOLE = 1 / 2
"""Side of the cut-out square, as a share of the side."""


def augment(images: Tensor, seeds: Tensor, changes: Sequence[str]) -> Tensor:
    """Apply changes in order to (B, C, H, W) images in [-1, 1]; (B,) seeds say how.

    Equal seeds give equal changes, so real and drawn images can undergo the same.
    """
    if not changes:
        return images
    drawn = uniform(seeds, 2 * len(CHANGES), STREAM).to(images.device)
    for change in changes:
        place = 2 * list(CHANGES).index(change)
        images = CHANGES[change](images, drawn[:, place : place + 2])
    return images


def _brightness(images: Tensor, u: Tensor) -> Tensor:
    return images + (u[:, :1, None, None] - 0.5)


def _contrast(images: Tensor, u: Tensor) -> Tensor:
    mean = images.mean((1, 2, 3), keepdim=True)
    return mean + (images - mean) * (u[:, :1, None, None] + 0.5)


def _translation(images: Tensor, u: Tensor) -> Tensor:
    """Shift by whole pixels; what comes in from outside is 0, as in the paper."""
    size = images.shape[-1]
    reach = int(size * SHIFT + 0.5)
    shift = (u * (2 * reach + 1)).floor().long() - reach
    rows = torch.arange(images.shape[-2], device=images.device) - shift[:, :1]
    columns = torch.arange(size, device=images.device) - shift[:, 1:]
    batch = torch.arange(len(images), device=images.device)[:, None, None]
    moved = images.permute(0, 2, 3, 1)[
        batch,
        rows.clamp(0, images.shape[-2] - 1)[:, :, None],
        columns.clamp(0, size - 1)[:, None, :],
    ].permute(0, 3, 1, 2)
    inside = _between(rows, 0, images.shape[-2])[:, :, None] & _between(columns, 0, size)[:, None]
    return moved * inside[:, None]


def _cutout(images: Tensor, u: Tensor) -> Tensor:
    size = images.shape[-1]
    hole = int(size * HOLE + 0.5)
    corner = (u * (size + 1)).floor().long() - hole // 2
    places = torch.arange(size, device=images.device)
    rows, columns = (places - corner[:, i : i + 1] for i in (0, 1))
    inside = _between(rows, 0, hole)[:, :, None] & _between(columns, 0, hole)[:, None]
    return images * ~inside[:, None]


def _between(values: Tensor, low: int, high: int) -> Tensor:
    return (values >= low) & (values < high)


CHANGES = {
    "brightness": _brightness,
    "contrast": _contrast,
    "translation": _translation,
    "cutout": _cutout,
}
"""What can be asked for."""
