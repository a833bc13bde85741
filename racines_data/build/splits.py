"""Splits by trajectory, and how the rows of a split are divided among shards.

Neighbouring frames of a sweep are near-copies, so a trajectory is never divided among splits.
"""

import hashlib
from collections import defaultdict
from collections.abc import Sequence

from racines_data.errors import RacinesError
from racines_data.sources.base import Unit

SHARD_FRAMES = 2048
"""Most frames in a shard, so that a full dataset has more shards, not larger ones."""


def assign_splits(
    units: Sequence[Unit], validation: float, test: float, seed: int
) -> dict[str, str]:
    """Return the split of each trajectory id, stratified by target view.

    A view with three trajectories or more is in every split. Views with fewer are pooled. Two
    trajectories in all make train and test; one makes train.

    Raises:
        RacinesError: the shares do not leave anything to train on.
    """
    if not (0 <= validation < 1 and 0 <= test < 1 and validation + test < 1):
        raise RacinesError(
            f"data.validation {validation} and data.test {test}: shares must lie in [0, 1) and "
            "leave something to train on"
        )
    splits: dict[str, str] = {}
    for stratum in _strata(units):
        ranked = sorted(stratum, key=lambda unit: _rank(unit.id, seed))
        tested = _share(len(ranked), test, len(ranked) - 1)
        validated = _share(len(ranked), validation, len(ranked) - 1 - tested)
        if len(ranked) == len(units) == 2:
            tested = int(test > 0)
        for index, unit in enumerate(ranked):
            held = "test" if index < tested else "validation"
            splits[unit.id] = held if index < tested + validated else "train"
    return splits


def assign_group_splits(
    units: Sequence[Unit], validation: float, test: float, seed: int
) -> dict[str, str]:
    """Return the split of each trajectory id such that a session is in one split."""
    sessions = dict.fromkeys(unit.session for unit in units)
    wholes = [Unit(name, name, "", 0) for name in sessions]
    splits = assign_splits(wholes, validation, test, seed)
    return {unit.id: splits[unit.session] for unit in units}


def _strata(units: Sequence[Unit]) -> list[list[Unit]]:
    by_view: dict[str, list[Unit]] = defaultdict(list)
    for unit in units:
        by_view[unit.target_view].append(unit)
    large = [group for group in by_view.values() if len(group) >= 3]
    pooled = [unit for group in by_view.values() if len(group) < 3 for unit in group]
    return [*large, pooled] if pooled else large


def _rank(unit_id: str, seed: int) -> str:
    return hashlib.sha256(f"{seed}/{unit_id}".encode()).hexdigest()


def _share(count: int, share: float, most: int) -> int:
    if count < 3 or not share:
        return 0
    return min(max(1, int(count * share + 0.5)), most)


def held_out_session(units: Sequence[Unit]) -> str | None:
    """Return the session kept for test in the `sessions` config: the last by name, if several."""
    sessions = sorted({unit.session for unit in units})
    return sessions[-1] if len(sessions) > 1 else None


def divide_shards(rows: Sequence[int], shards: int) -> list[int]:
    """Return the number of shards of each group of rows, in proportion, at least one each.

    In total `shards` or more where a shard would be too large, never more than there are rows.
    """
    wanted = min(max(shards, -(-sum(rows) // SHARD_FRAMES)), sum(rows))
    counts = [1 if count else 0 for count in rows]
    while sum(counts) < wanted:
        largest = max(range(len(rows)), key=lambda i: rows[i] / counts[i] if counts[i] else 0.0)
        counts[largest] += 1
    return counts


def shard_bounds(rows: int, shards: int) -> list[tuple[int, int]]:
    """Return (start, stop) of each shard of a group of rows, of sizes that differ by one."""
    return [(rows * i // shards, rows * (i + 1) // shards) for i in range(shards)]
