"""Ranking the results of one track."""

from dataclasses import dataclass
from typing import Any

from racines_leaderboard.tracks import Column, Track

Record = dict[str, Any]
EXPERT = "expert_"
"""Begins the keys of figures that an expert study gave."""


@dataclass(frozen=True)
class Ranked:
    """A result with its place; equal systems share a place, as in 1, 2, 2, 4. A bound has none."""

    place: int | None
    record: Record


def is_bound(record: Record) -> bool:
    """Return whether a result is a ceiling that knows the truth, or a floor that sees nothing."""
    return record["scores"].get("sees") in ("truth", "nothing")


def figure(record: Record, key: str) -> dict[str, Any] | None:
    """Return a figure of a result, or None where it is absent or has no value.

    Figures of experts come from a study that was checked, never from the scores of a submission.
    """
    source = record.get("expert", {}) if key.startswith(EXPERT) else record["scores"]["metrics"]
    metric = source.get(key)
    return metric if metric is not None and metric["value"] is not None else None


def rank(track: Track, records: list[Record]) -> list[Ranked]:
    """Order the results of a track by its rule, best first; equal ones by name.

    Bounds stand among the others by their figures, and take no place.
    """
    columns = {column.key: column for column in track.columns}
    deciding = [columns[key] for key in track.ranked_by]
    if track.mean_rank:
        keys = _mean_ranks(deciding, records)
    else:
        keys = [tuple(_badness(record, column) for column in deciding) for record in records]
    order = sorted(range(len(records)), key=lambda i: (keys[i], records[i]["name"]))
    rivals = [keys[i] for i in order if not is_bound(records[i])]
    ranking = []
    for i in order:
        place = 1 + sum(key < keys[i] for key in rivals)
        ranking.append(Ranked(None if is_bound(records[i]) else place, records[i]))
    return ranking


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
