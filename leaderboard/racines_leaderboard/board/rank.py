"""Ranking the results of one track; what the intervals do not separate shares a rank.

By one metric: the best leads a group of all that follow, as far as their 95 % intervals overlap the
leader's; the next one leads the next group. A group shares the mean of the ranks that its members
would take alone, as in 1.5, 1.5, 3, so a tie of others neither helps nor hurts. Overlap is not
transitive: without a leader a long chain of neighbours would share a rank, with a first and a last
that are far apart. Groups are runs of the order by value: a wide interval overtakes no better one.
"""

from dataclasses import dataclass
from typing import Any

from scipy.stats import rankdata

from racines_leaderboard.records.tracks import Column, Track

Record = dict[str, Any]
EXPERT = "expert_"
"""Begins the keys of metrics that an expert study gave."""
SHOWN = {
    "image": " from the image",
    "params": " from the pose",
    "multimodal": " from image and pose",
}


@dataclass(frozen=True)
class Ranked:
    """A result with its place; tied systems share a place, as in 1, 2, 2, 4. A bound has none."""

    place: int | None
    record: Record


def is_bound(record: Record) -> bool:
    """Return whether a result is a ceiling that knows the truth, or a floor that sees nothing."""
    return record["scores"].get("sees") in ("truth", "nothing")


def metric_of(record: Record, key: str) -> dict[str, Any] | None:
    """Return a metric of a result, or None where it is absent or has no value.

    Metrics of experts come from a study that was checked, never from the scores of a submission.
    """
    source = record.get("expert", {}) if key.startswith(EXPERT) else record["scores"]["metrics"]
    metric = source.get(key)
    return metric if metric is not None and metric["value"] is not None else None


def by_task(records: list[Record]) -> dict[str, list[Record]]:
    """Group the results that compare: generators all together, agents by task.

    A task is a view, what is shown of it, and what draws the images. Bounds stand in every group of
    their view and backend; in one of their own where there is no other.
    """
    groups: dict[tuple[str, str, str], list[Record]] = {}
    bounds: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        task = record["scores"].get("task") or dict.fromkeys(("view", "backend", "observation"), "")
        place = task["view"], task["backend"]
        if is_bound(record):
            bounds.setdefault(place, []).append(record)
        else:
            groups.setdefault((*place, task["observation"]), []).append(record)
    for place, floor_and_ceiling in bounds.items():
        held = [group for key, group in groups.items() if key[:2] == place]
        for group in held or [groups.setdefault((*place, ""), [])]:
            group.extend(floor_and_ceiling)
    return {
        f"{view}{SHOWN.get(shown, '')}, {backend} backend" if view else "": group
        for (view, backend, shown), group in sorted(groups.items())
    }


def rankings(track: Track, records: list[Record]) -> list[Ranked]:
    """Return the ranked results of all tasks, one after another; a bound in the first alone."""
    first: dict[str, Ranked] = {}
    for group in by_task(records).values():
        for ranked in rank(track, group):
            first.setdefault(ranked.record["name"], ranked)
    return list(first.values())


def rank(track: Track, records: list[Record]) -> list[Ranked]:
    """Order the results of a track by its rule, best first; tied ones by metric, then by name.

    Bounds stand among the others by their metrics, take no place and tie with nothing.
    """
    columns = {column.key: column for column in track.columns}
    deciding = [columns[key] for key in track.ranked_by]
    rivals = [record for record in records if not is_bound(record)]
    keys = (_mean_ranks if track.mean_rank else _ranks_in_turn)(deciding, rivals)
    plain = _plain_keys(track, deciding, records)
    by_metrics = {id(record): key for record, key in zip(records, plain, strict=True)}
    order = sorted(
        range(len(rivals)), key=lambda i: (keys[i], by_metrics[id(rivals[i])], rivals[i]["name"])
    )
    ranking = [Ranked(1 + sum(key < keys[i] for key in keys), rivals[i]) for i in order]
    bounds = (record for record in records if is_bound(record))
    for bound in sorted(bounds, key=lambda record: record["name"], reverse=True):
        own = by_metrics[id(bound)]
        worse = (i for i, each in enumerate(ranking) if by_metrics[id(each.record)] > own)
        ranking.insert(next(worse, len(ranking)), Ranked(None, bound))
    return ranking


def tied(ranking: list[Ranked]) -> set[int]:
    """Return the places that several results share."""
    places = [each.place for each in ranking if each.place is not None]
    return {place for place in places if places.count(place) > 1}


def _badness(record: Record, column: Column) -> tuple[float, float, float]:
    """A metric and the better and worse end of its interval: lower is better, infinite missing."""
    metric = metric_of(record, column.key)
    if metric is None:
        return float("inf"), float("inf"), float("inf")
    value = metric["value"]
    low, high = (value if metric[key] is None else metric[key] for key in ("low", "high"))
    return (-value, -high, -low) if column.better == "higher" else (value, low, high)


def _group_ranks(column: Column, records: list[Record]) -> list[float]:
    """Return each record's rank by one metric; a group shares the mean of its members' ranks."""
    metrics = [_badness(record, column) for record in records]
    groups = [0] * len(records)
    group, reach = 0, -float("inf")
    for i in sorted(range(len(records)), key=lambda i: metrics[i][0]):
        _, best, worst = metrics[i]
        if best > reach or not group:
            group, reach = group + 1, worst
        groups[i] = group
    return rankdata(groups).tolist()


def _mean_ranks(columns: list[Column], records: list[Record]) -> list[tuple[float, ...]]:
    by_column = [_group_ranks(column, records) for column in columns]
    return [(sum(ranks) / len(columns),) for ranks in zip(*by_column, strict=True)]


def _ranks_in_turn(columns: list[Column], records: list[Record]) -> list[tuple[float, ...]]:
    """Return ranks by the first metric, then among those tied in it by the next, and so on."""
    keys: list[tuple[float, ...]] = [()] * len(records)
    for column in columns:
        groups: dict[tuple[float, ...], list[int]] = {}
        for i, key in enumerate(keys):
            groups.setdefault(key, []).append(i)
        for rows in groups.values():
            for i, rank in zip(rows, _group_ranks(column, [records[i] for i in rows]), strict=True):
                keys[i] += (rank,)
    return keys


def _plain_keys(
    track: Track, columns: list[Column], records: list[Record]
) -> list[tuple[float, ...]]:
    """Return the order by the metrics alone: within ties, and for bounds."""
    values = [[_badness(record, column)[0] for record in records] for column in columns]
    if not track.mean_rank:
        return list(zip(*values, strict=True))
    ranks = [rankdata(column, "min").tolist() for column in values]
    return [(sum(each) / len(columns),) for each in zip(*ranks, strict=True)]
