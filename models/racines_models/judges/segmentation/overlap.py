"""How far two outlines agree: Dice by structure, with intervals whose units are patients.

Dice, 2 |A ∩ B| / (|A| + |B|), is asked of frames in which the truth has the structure. Where it has
not, it would be 0 for one stray pixel: those frames have a share of false outlines of their own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_models.statistics import mean_interval, rate_interval

FEWEST = 40
"""Pixels of 128 x 128 from which on a structure is there: a disk seven pixels across."""


def areas(masks: Tensor, count: int) -> Tensor:
    """Return the (N, count) pixels of the structures 1 … count of (N, H, W) uint8 masks."""
    return torch.stack([(masks == k).sum((1, 2)) for k in range(1, count + 1)], 1)


def dice(found: Tensor, truth: Tensor, count: int) -> Tensor:
    """Return the (N, count) float64 Dice of structures 1 … count, NaN where the truth has none.

    Args:
        found: (N, H, W) uint8 masks.
        truth: (N, H, W) uint8 masks.
        count: number of structures.
    """
    both = areas(torch.where(found == truth, truth, 0), count).double()
    true = areas(truth, count)
    values = 2.0 * both / (areas(found, count) + true).clamp_min(1)
    return values.masked_fill(true < FEWEST, torch.nan)


def overlap_figures(
    found: Tensor, truth: Tensor, structures: Sequence[str], patients: np.ndarray
) -> dict[str, Any]:
    """Return `dice_…` of each structure, and `false_…` where frames without it are among them.

    `false_…` is the share of frames without a structure in which `found` has it.
    """
    values, figures = dice(found, truth, len(structures)).numpy(), {}
    counts = (areas(found, len(structures)) >= FEWEST, areas(truth, len(structures)) == 0)
    outlined, absent = (each.numpy() for each in counts)
    for place, name in enumerate(structures):
        key = name.lower().replace(" ", "_")
        if np.isfinite(values[:, place]).any():
            mean = mean_interval(values[:, place], patients, 0.0, 1.0)
            figures[f"dice_{key}"] = mean.to_json()
        if absent[:, place].any():
            false = np.where(absent[:, place], outlined[:, place], np.nan)
            figures[f"false_{key}"] = rate_interval(false, patients).to_json()
    return figures
