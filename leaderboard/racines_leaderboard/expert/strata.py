"""Which poses a study shows: as many of each view, and of each range of its grades."""

import numpy as np

from racines_data.errors import RacinesError

GRADE_EDGES = (4.0, 7.0)
"""Thirds of the scale of a view, 1-10: poor below 4, fair below 7, good from there on."""


def allocate(total: int, capacities: np.ndarray) -> np.ndarray:
    """Share `total` out over (G,) groups as evenly as their capacities allow; (G,) int64.

    What does not divide goes to the first groups that have room.

    Raises:
        RacinesError: the groups hold fewer than `total`.
    """
    capacities = np.asarray(capacities, np.int64)
    if total > capacities.sum():
        raise RacinesError(f"{total} wanted of {capacities.sum()}: ask for fewer images")
    shares = np.zeros_like(capacities)
    while left := total - int(shares.sum()):
        free = np.flatnonzero(shares < capacities)
        step = max(left // len(free), 1)
        for group in free[:left]:
            shares[group] += min(step, capacities[group] - shares[group])
    return shares


def stratify(
    views: np.ndarray,
    grades: np.ndarray,
    trajectories: np.ndarray,
    total: int,
    random: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Choose `total` of N frames, balanced over views, then grades, then trajectories.

    Args:
        views: (N,) labels, -1 where unknown, which counts as one more view.
        grades: (N,) grades 0-10, NaN where unknown.
        trajectories: (N,) the trajectory of each, an integer.
        total: Frames wanted.
        random: The label of `Random`, whose frames have one grade.
        rng: Decides which frames, and their order.

    Returns:
        (total,) int64 places of the chosen frames, in random order.

    Raises:
        RacinesError: there are fewer frames.
    """
    bins = np.digitize(np.nan_to_num(grades), GRADE_EDGES)
    bins[(views < 0) | (views == random)] = 0
    present = np.unique(views)
    wanted = allocate(total, np.array([(views == view).sum() for view in present]))
    chosen = []
    for view, count in zip(present, wanted, strict=True):
        groups = [np.flatnonzero((views == view) & (bins == b)) for b in np.unique(bins)]
        shares = allocate(int(count), np.array([len(group) for group in groups]))
        for group, share in zip(groups, shares, strict=True):
            chosen.append(_spread(group, trajectories[group], int(share), rng))
    return rng.permutation(np.concatenate(chosen))


def _spread(
    places: np.ndarray, trajectories: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Take `count` of (n,) places, from each trajectory one before any gives a second."""
    order = rng.permutation(len(places))
    turn = np.empty(len(places), np.int64)
    for trajectory in np.unique(trajectories):
        own = order[trajectories[order] == trajectory]
        turn[own] = np.arange(len(own))
    return places[order[np.argsort(turn[order], kind="stable")][:count]]
