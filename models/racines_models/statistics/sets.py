"""Replicates of statistics of whole sets, such as FID: of the set without each block of units."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from racines_models.statistics.intervals import BLOCKS, Replicates, blocks_of, checked


def set_replicates(
    statistics: Sequence[Callable[[np.ndarray], float]], units: np.ndarray, most: int = BLOCKS
) -> Replicates:
    """Return the replicates of a statistic of a set of N items; one function a training.

    Each takes a (N,) boolean mask of the items to keep.
    """
    named = [lambda keep, each=each: {"": each(keep)} for each in statistics]
    return set_replicates_all(named, units, most)[""]


def set_replicates_all(
    statistics: Sequence[Callable[[np.ndarray], Mapping[str, float]]],
    units: np.ndarray,
    most: int = BLOCKS,
) -> dict[str, Replicates]:
    """Return the replicates of several statistics that are computed together, by name."""
    blocks = blocks_of(units, most)
    count = int(blocks.max()) + 1
    masks = [blocks != block for block in range(count if count > 1 else 0)]
    # A set of one item has no spread, and so no distance to another.
    masks = [np.ones(len(blocks), bool), *(mask for mask in masks if mask.sum() > 1)]
    found = [[statistic(mask) for mask in masks] for statistic in statistics]
    replicates = {}
    for name in found[0][0]:
        values = np.array([[each[name] for each in row] for row in found], np.float64)
        several = values[:, 0], values[:, 1:], len(np.unique(units)), len(blocks)
        replicates[name] = checked(*several)
    return replicates
