"""Frames with masks, rasterised: an apical heart of three ellipses in a sector of speckle."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from racines_models.judges.segmentation.frames import MaskSet

LABELS = ("background", "LV", "LV myocardium", "LA", "papillary muscle", "liver")
"""A world's labels; the judge outlines three of them, and takes papillary muscle for cavity."""
GRAY = (0.35, 0.05, 0.7, 0.08, 0.5, 0.9)
"""Mean light by label."""


def heart_mask(size: float, x: float, y: float, long: float = 1.0) -> Tensor:
    """(128, 128) uint8: LV above its atrium, apex up; `size` 1 has an LV 26 x 44 pixels inside."""
    down, right = torch.meshgrid(torch.arange(128.0), torch.arange(128.0), indexing="ij")
    right, down = (right - 64 - x) / size, (down - 55 - y) / size

    def ellipse(cy: float, rx: float, ry: float) -> Tensor:
        return (right / rx).square() + ((down - cy) / ry).square() < 1

    lower = down > 22 * long
    mask = torch.zeros(128, 128, dtype=torch.uint8)
    mask[ellipse(0, 20, 33 * long) & ~lower] = 2
    mask[ellipse(0, 13, 28 * long) & ~lower] = 1
    mask[ellipse(33 * long, 13, 12) & lower] = 3
    mask[ellipse(-5, 3, 4) & (right > 0)] = 4
    return mask


def sector() -> Tensor:
    """(128, 128) bool: the apex at the top centre."""
    y, x = torch.meshgrid(torch.arange(128.0) + 2, torch.arange(128.0) - 63.5, indexing="ij")
    return (torch.atan2(x, y).abs() < 0.65) & (x.hypot(y) < 118)


def draw(masks: Tensor, seed: int) -> Tensor:
    """(N, 128, 128) uint8 images of (N, 128, 128) masks: Rayleigh speckle by label."""
    generator = torch.Generator().manual_seed(seed)
    real, imaginary = torch.randn(2, *masks.shape, generator=generator)
    light = torch.tensor(GRAY)[masks.long()] * (0.6 + 0.4 * real.hypot(imaginary))
    return (light.clamp(0.01, 1) * 255 * sector()).to(torch.uint8)


def mask_set(patients: int = 30, each: int = 8, seed: int = 0) -> MaskSet:
    """`each` frames of each patient; six tenths of them train, one validates."""
    generator = np.random.default_rng(seed)
    masks = []
    for _ in range(patients):
        size = generator.uniform(0.8, 1.2)
        places = generator.uniform(-8, 8, (each, 2))
        masks += [heart_mask(size, x, y, generator.uniform(0.9, 1.1)) for x, y in places]
    rows = torch.arange(patients * each).split(
        [6 * len(masks) // 10, len(masks) // 10, 3 * len(masks) // 10]
    )
    stacked = torch.stack(masks) * sector()
    who = np.arange(patients).repeat(each)
    strata: dict[str, Sequence[str]] = {"pathology": [("healthy", "dilated")[i % 2] for i in who]}
    splits = dict(zip(("train", "validation", "test"), rows, strict=True))
    card = {"source": "rasterised", "seed": seed}
    return MaskSet(draw(stacked, seed), stacked, who, splits, LABELS, card, strata)


def hearts(patients: int) -> Tensor:
    """(2 P, 128, 128) masks: ED and ES of each patient, the second smaller."""
    masks = []
    for i in range(patients):
        masks += [heart_mask(1.0 + 0.02 * i, 0, 0), heart_mask(0.8 + 0.02 * i, 0, 0)]
    stacked = torch.stack(masks) * sector()
    return torch.where(stacked == 4, 1, stacked)
