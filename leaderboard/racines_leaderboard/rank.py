"""Ranking the results of one track."""

from dataclasses import dataclass
from typing import Any

from racines_leaderboard.tracks import Column, Track

Record = dict[str, Any]
EXPERT = "expert_"
"""Begins the keys of figures that an expert study gave."""


@dataclass(frozen=True)
class Ranked:
    """A result with its place; equal systems share a place, as in 1, 2, 2, 4."""

    place: int
    record: Record


def figure(record: Record, key: str) -> dict[str, Any] | None:
    """Return a figure of a result, or None where it is absent or has no value.

    Figures of experts come from a study that was checked, never from the scores of a submission.
    """
    source = record.get("expert", {}) if key.startswith(EXPERT) else record["scores"]["metrics"]
    metric = source.get(key)
    return metric if metric is not None and metric["value"] is not None else None


def rank(track: Track, records: list[Record]) -> list[Ranked]:
    """Order the results of a track by its rule, best first; equal ones by name."""
    columns = {column.key: column for column in track.columns}
    judged = [columns[key] for key in track.ranked_by]
    if track.mean_rank:
        keys = _mean_ranks(judged, records)
    else:
        keys = [tuple(_badness(record, column) for column in judged) for record in records]
    return [Ranked(place, records[i]) for place, i in _places(keys, records)]


def _badness(record: Record, column: Column) -> float:
    """A number that is lower for a better figure and infinite for a missing one."""
    metric = figure(record, column.key)
    if metric is None:
        return float("inf")
    return -metric["value"] if column.better == "higher" else metric["value"]


def _mean_ranks(columns: list[Column], records: list[Record]) -> list[tuple[float, ...]]:
    totals = [0.0] * len(records)
    for column in columns:
        values = [_badness(record, column) for record in records]
        for i, value in enumerate(values):
            totals[i] += 1 + sum(other < value for other in values)
    return [(total / len(columns),) for total in totals]


def _places(keys: list[tuple[float, ...]], records: list[Record]) -> list[tuple[int, int]]:
    order = sorted(range(len(records)), key=lambda i: (keys[i], records[i]["name"]))
    return [(1 + sum(key < keys[i] for key in keys), i) for i in order]
