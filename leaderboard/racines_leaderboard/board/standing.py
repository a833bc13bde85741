"""How a record stands: its score between the board's anchors, and why it has no place, if so.

The score is the mean of the ranked metrics, each put on the line from 0 at one anchor to 1 at the
other. Both are values in the board's file, so a score depends on its own record and that file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_leaderboard.board.evidence import distinct_trainings, read_evidence
from racines_leaderboard.records.columns import TRAININGS, Track
from racines_leaderboard.records.pins import Pin, anchored
from racines_leaderboard.records.tracks import track_of
from racines_models.statistics import Evidence
from racines_models.statistics.intervals import (
    Interval,
    Replicates,
    combine,
    difference,
    interval,
)
from racines_models.statistics.stacked import Stacked

Record = dict[str, Any]
UNPINNED = "no anchors"
"""Why nothing of a board without a file, or of a task without anchors, has a place."""
BOUND = "bound"
NO_EVIDENCE = "no evidence"
REPEATED = "repeated training"
_COUNTS = {1: "one training", 2: "two trainings"}


@dataclass(frozen=True)
class Standing:
    """The score of a record, with what it is compared by."""

    score: Interval | None = None
    """Without ends where there is no evidence; None without anchors."""
    why: str = UNPINNED
    """Why the record has no place; empty where it has one."""
    replicates: Replicates | None = field(default=None, compare=False, repr=False)
    """Of the score; None without evidence."""
    trainings: int | None = None
    units: int | None = None

    def ahead_of(self, other: "Standing") -> bool:
        """Return whether this one is ahead: by score, and by the interval of the difference.

        Nothing but the two decides it.
        """
        if self.replicates is None or other.replicates is None:
            return False
        if self.replicates.value <= other.replicates.value:
            return False
        low = difference(self.replicates, other.replicates, "score difference").low
        return low is not None and low > 0


def ahead_of_each(standings: Sequence[Standing]) -> list[int]:
    """Return how many of the others are ahead of each, as `Standing.ahead_of` says of two.

    Raises:
        ValueError: their scores do not rest on the same units.
    """
    ahead = [0] * len(standings)
    known = [(i, own) for i, each in enumerate(standings) if (own := each.replicates) is not None]
    known.sort(key=lambda each: -each[1].value)
    stack = Stacked.of([own for _, own in known])
    for place, (i, _) in enumerate(known):
        higher = slice(0, int(np.searchsorted(-stack.value, -stack.value[place])))
        ahead[i] = int((stack.lows(higher, place) > 0).sum())
    return ahead


def is_bound(record: Record) -> bool:
    """Return whether a result is a bound: it knows the truth, sees nothing, or looks it up."""
    scores = record["scores"]
    if scores.get("sees") in ("truth", "nothing"):
        return True
    artefacts = (record.get("submission") or {}).get("artefacts") or ()
    if any(each["kind"] == "trace" for each in artefacts):
        return True
    track = track_of(scores)
    bounds = () if track is None else track.bounds
    if "motion" in scores:
        return scores["told_first"] or scores["motion"] in bounds
    modules = {f"racines_models.generators.{name.replace('-', '_')}" for name in bounds}
    adapters = {str(each.get("adapter", "")).partition(":")[0] for each in artefacts}
    return scores.get("generator") in bounds or bool(adapters & modules)


def with_standing(record: Record, path: Path, track: Track, pin: Pin | None) -> Record:
    """Add to a record how it stands on a pinned board, as `standing`.

    Raises:
        RacinesError: as `read_evidence`, or figures that do not rest on the same units.
    """
    if pin is None:
        return record
    evidence = read_evidence(path, record["scores"], track, pin)
    return record | {"standing": standing(record, evidence, track, pin)}


def standing_of(record: Record) -> Standing:
    """Return how a record of a board stands; one that was read without its board has no score."""
    return record.get("standing") or Standing(trainings=record["scores"].get("runs"))


def standing(record: Record, evidence: Evidence | None, track: Track, pin: Pin) -> Standing:
    """Return how a record stands between a board's anchors.

    Raises:
        RacinesError: a ranked metric without an anchor, or figures on units of their own.
    """
    scores = record["scores"]
    part, trainings = anchored(scores, track, pin), scores.get("runs")
    if part is None:
        return Standing(trainings=trainings)
    values = part["anchors"]["values"]
    if missing := [key for key in track.ranked_by if key not in values]:
        raise RacinesError(
            f"board {pin['board']}: no anchor of {', '.join(missing)}: pin it again with "
            f"`racines board pin {pin['board']} --force`"
        )
    bound = BOUND if is_bound(record) else ""
    if evidence is None:
        score = score_of_values(scores["metrics"], track, values)
        return Standing(score, bound or NO_EVIDENCE, None, trainings)
    figures = [evidence.figures[key].replicates() for key in track.ranked_by]
    try:
        found = combine(lambda each: anchor(each, track, values).mean(0), figures)
    except ValueError as error:
        name = record["name"]
        raise RacinesError(f"{name}: evidence: {error}; score it again") from error
    trainings, why = len(found.whole), ""
    if scores.get("trained", True):
        if trainings < TRAININGS:
            why = _COUNTS[trainings]
        elif distinct_trainings(evidence) < trainings:
            why = REPEATED
    return Standing(interval(found, kind="score"), bound or why, found, trainings, found.units)


def anchor(metrics: np.ndarray, track: Track, values: dict[str, list[float]]) -> np.ndarray:
    """Put (M, …) values of the ranked metrics on the line from 0 to 1 between their anchors."""
    ends = np.array([values[key] for key in track.ranked_by], np.float64)
    zero, one = ends.T.reshape(2, -1, *(1,) * (metrics.ndim - 1))
    return (metrics - zero) / (one - zero)


def score_of_values(
    metrics: dict[str, Any], track: Track, values: dict[str, list[float]]
) -> Interval:
    """Return the score of a record's values, without an interval."""
    ranked = [metrics[key] for key in track.ranked_by]
    points = anchor(np.array([each["value"] for each in ranked]), track, values)
    n = min(each["n"] for each in ranked)
    return Interval(float(points.mean()), None, None, n, 0, 0, "none: no evidence")
