"""Ranking the results of one track by scores that no other entry can change.

Of two results one is ahead if its score is the higher and the paired interval of the difference
leaves out 0; else they are tied. Nobody else has a say in it, so no level is divided by the number
of comparisons either. A place is 1 and how many of those with a place are ahead; only that number
can change when others come and go. Rows stand in the order of scores.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Any

from racines_leaderboard.board.standing import (
    UNPINNED,
    Standing,
    ahead_of_each,
    is_bound,
    standing_of,
)
from racines_leaderboard.records.robustness import PREFIX as DISTURBED
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
    """A result with its place; tied systems may share one, as in 1, 2, 2, 4."""

    place: int | None
    """None for a result without a place; its standing says why."""
    record: Record

    @property
    def standing(self) -> Standing:
        """How the result stands."""
        return standing_of(self.record)


def metric_of(record: Record, key: str) -> dict[str, Any] | None:
    """Return a metric of a result, or None where it is absent or has no value.

    Metrics of experts and of robustness come from what was checked, never from scores.
    """
    source = record["scores"]["metrics"]
    if key.startswith(EXPERT):
        source = record.get("expert", {})
    elif key.startswith(DISTURBED):
        source = record.get("robustness", {}).get("metrics", {})
    metric = source.get(key)
    return metric if metric is not None and metric["value"] is not None else None


def verdict_of(record: Record) -> str:
    """Return what an audit said of a record that was read with its board; empty where none did."""
    return record.get("verdict", "")


def score_metric(record: Record) -> dict[str, Any] | None:
    """Return the score of a result as a metric, or None where its board has no anchors."""
    score = standing_of(record).score
    if score is None:
        return None
    settings = {} if score.level is None else {"level": score.level}
    return {key: getattr(score, key) for key in ("value", "low", "high", "n")} | {
        "settings": settings
    }


SCORE = Column("score", "Score", "higher", value=score_metric)


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
        if task["view"] and is_bound(record):
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
    """Order results by score, best first; equal ones, and those without a score, by name.

    Results without a place stand among the others and are ahead of nobody.
    """

    def order(record: Record) -> tuple[float, str]:
        score = standing_of(record).score
        return (float("inf") if score is None else -score.value), record["name"]

    ordered = sorted(records, key=order)
    ahead = iter(ahead_of_each([each for each in map(standing_of, ordered) if not each.why]))
    return [
        Ranked(None if standing_of(record).why else 1 + next(ahead), record) for record in ordered
    ]


def unpinned(ranking: list[Ranked]) -> bool:
    """Return whether a ranking has no anchors, and so no scores."""
    return all(each.standing.why == UNPINNED for each in ranking)


def tied(ranking: list[Ranked]) -> set[int]:
    """Return the places that several results share."""
    places = [each.place for each in ranking if each.place is not None]
    return {place for place, count in Counter(places).items() if count > 1}
