"""The design of a study: poses balanced over views and grades, and names that tell nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from racines_data.errors import RacinesError

GRADE_EDGES = (4.0, 7.0)
"""Thirds of the scale of a view, 1-10: poor below 4, fair below 7, good from there on."""


def allocate(total: int, capacities: np.ndarray) -> np.ndarray:
    """Share `total` out over (G,) groups as evenly as their capacities allow; (G,) int64.

    What does not divide goes to the first groups that have room; RacinesError if all are too few.
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

    Views are (N,) labels, -1 where unknown, which counts as one more; `random` is the label of
    `Random`, whose frames have one grade. Grades are (N,), 0-10, NaN where unknown, trajectories
    (N,) integers. Returns (total,) int64 places in random order; RacinesError if they are fewer.
    """
    bins = np.digitize(np.nan_to_num(grades), GRADE_EDGES)
    bins[(views < 0) | (views == random)] = 0
    present, counts = np.unique(views, return_counts=True)
    chosen = []
    for view, count in zip(present, allocate(total, counts), strict=True):
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


@dataclass(frozen=True)
class Plan:
    """The names of M = images + repeats entries, and the blocks in which they are shown."""

    entries: np.ndarray
    """(M,) which image each entry shows; the repeats come last."""
    names: list[str]
    """(M,) the blind name of each entry."""
    blocks: list[list[str]]
    """Three blocks of sorted names. The two of a repeated image lie in the first and the last, so
    that at least the middle block lies between them, however each block is shuffled."""

    def named(self, answers: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Return the answer to each name, in order, with the name that it repeats."""
        named = {}
        for place, (entry, name) in enumerate(zip(self.entries, self.names, strict=True)):
            first = self.names[entry] if place >= len(answers) else None
            named[name] = answers[entry] | {"repeat_of": first}
        return dict(sorted(named.items()))


def blind(systems: Sequence[str], repeats: int, rng: np.random.Generator) -> Plan:
    """Choose at most half of N images to repeat, as many of each system; name all by chance."""
    names = np.array(systems)
    present, counts = np.unique(names, return_counts=True)
    shares = zip(present, allocate(repeats, counts), strict=True)
    chosen = [rng.permutation(np.flatnonzero(names == name))[:share] for name, share in shares]
    again = np.concatenate(chosen)
    total = len(names) + repeats
    width = max(4, len(str(total)))
    blind_names = [f"{number:0{width}d}" for number in rng.permutation(total) + 1]
    twins = np.arange(len(names), total)
    # Which of the two comes in the first block is chance: the first is the one that is scored.
    swap = rng.random(repeats) < 0.5
    first, last = np.where(swap, twins, again), np.where(swap, again, twins)
    others = rng.permutation(np.setdiff1d(np.arange(len(names)), again))
    cut = np.array([total // 3 - repeats, total - 2 * (total // 3)]).cumsum()
    a, b, c = np.split(others, cut)
    blocks = [np.concatenate([first, a]), b, np.concatenate([last, c])]
    shown = [sorted(blind_names[entry] for entry in block) for block in blocks]
    return Plan(np.concatenate([np.arange(len(names)), again]), blind_names, shown)
