from collections import Counter

import pytest

from racines_data import RacinesError
from racines_data.build.writer import (
    assign_group_splits,
    assign_splits,
    divide_shards,
    held_out_session,
    shard_bounds,
)
from racines_data.sources.base import Unit
from racines_data.views import LABELS


def units(count: int, views: tuple[str, ...] = LABELS) -> list[Unit]:
    return [Unit(f"t{i}", f"s{i % 3}", views[i % len(views)], 10) for i in range(count)]


def test_every_view_is_in_every_split():
    trajectories = units(120)
    splits = assign_splits(trajectories, 0.15, 0.15, seed=0)
    seen = Counter((unit.target_view, splits[unit.id]) for unit in trajectories)
    assert {seen[view, "test"] for view in LABELS} == {3}
    assert {seen[view, "train"] for view in LABELS} == {14}


def test_a_split_depends_on_the_seed_and_not_on_the_order():
    trajectories = units(60)
    splits = assign_splits(trajectories, 0.15, 0.15, seed=0)
    assert assign_splits(trajectories[::-1], 0.15, 0.15, seed=0) == splits
    assert assign_splits(trajectories, 0.15, 0.15, seed=1) != splits


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (1, {"train": 1}),
        (2, {"train": 1, "test": 1}),
        (3, {"train": 1, "validation": 1, "test": 1}),
        (5, {"train": 3, "validation": 1, "test": 1}),
    ],
)
def test_few_trajectories(count: int, expected: dict[str, int]):
    splits = assign_splits(units(count, ("Random",)), 0.15, 0.15, seed=0)
    assert Counter(splits.values()) == expected


@pytest.mark.parametrize(
    ("count", "validation", "test", "expected"),
    [
        (10, 0.3, 0.15, {"train": 5, "validation": 3, "test": 2}),  # rounded, a half upwards
        (10, 0.0, 0.14, {"train": 9, "test": 1}),
        (3, 0.05, 0.9, {"train": 1, "test": 2}),  # something is left to train on
        (2, 0.4, 0.0, {"train": 2}),
    ],
)
def test_each_split_has_its_own_share(count, validation, test, expected):
    splits = assign_splits(units(count, ("Random",)), validation, test, seed=0)
    assert Counter(splits.values()) == expected


def test_rare_views_are_pooled():
    splits = assign_splits(units(6), 0.15, 0.15, seed=0)
    assert set(splits.values()) == {"train", "validation", "test"}
    mixed = units(12, ("A4C", "A4C", "A4C", "SC", "A4C", "PL"))
    assert set(assign_splits(mixed, 0.15, 0.15, seed=0)) == {unit.id for unit in mixed}


def test_a_session_is_in_one_split():
    trajectories = [Unit(f"t{i}", f"s{i % 8}", LABELS[i % 6], 10) for i in range(48)]
    splits = assign_group_splits(trajectories, 0.2, 0.2, seed=0)
    of_session = {unit.session: splits[unit.id] for unit in trajectories}
    assert all(splits[unit.id] == of_session[unit.session] for unit in trajectories)
    assert Counter(of_session.values()) == {"train": 4, "validation": 2, "test": 2}
    assert assign_group_splits(trajectories, 0.2, 0.2, seed=1) != splits


def test_shares_that_leave_nothing_are_refused():
    with pytest.raises(RacinesError, match="leave something to train on"):
        assign_splits(units(6), 0.5, 0.5, seed=0)


def test_shards_are_in_proportion_and_never_empty():
    assert divide_shards([700, 100, 150, 0], 16) == [11, 2, 3, 0]
    assert divide_shards([2, 1], 16) == [2, 1]
    assert sum(divide_shards([144_668], 16)) == 71
    assert shard_bounds(10, 3) == [(0, 3), (3, 6), (6, 10)]


def test_the_last_session_is_held_out():
    assert held_out_session(units(6)) == "s2"
    assert held_out_session(units(1)) is None
