"""Recomputed numbers against those of a record, each within what its tier allows.

bitwise     the same libraries, processor, threads, data and weights: every bit
tolerance   elsewhere: the metrics that rank within 0.0004; the others within 0.001 of their
            size, or two items of n
half        from half-precision weights: the same, or a quarter of the interval's half-width;
            of a metric that does not rank, what is off by more but by less than the half-width
            cannot be told: other weights draw other images
"""

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

from racines_leaderboard.audit.claims import differing
from racines_leaderboard.audit.metrics import TIMED
from racines_leaderboard.audit.roads import HALF
from racines_leaderboard.audit.verdicts import Verdict, fails, holds, unknown
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.tracks import TRACK

BITWISE, TOLERANCE = "bitwise", "tolerance"
PRIMARY = 4e-4
"""Of the metrics that rank, in their own unit: below half of 0.001."""
OTHERS, ITEMS = 1e-3, 2.0
SHARE = 0.25
"""Of the half-width of an interval, for half-precision weights."""
NUMBERS = ("value", "low", "high", "n")
CONTINUOUS = ("ssim", "psnr", "fid", "kid", "final_grade", "spl", "position_error", "return")
"""Figures that are equal to the last bit by no accident."""


def agreement(record: Record, made: dict[str, Any], road: str) -> str:
    """Return how near the numbers must come: `bitwise`, `tolerance` or `half precision`.

    The name of a processor does not tell all of it. Where the machines are the same by name and
    not half of the continuous metrics are equal, they are not the same.
    """
    if road == HALF:
        return HALF
    same = not differing(record["scores"]["environment"], made["environment"])
    if record["track"] == "generators":
        same &= record["scores"]["dataset"]["digest"] == made["dataset"]["digest"]
    pairs = [
        (metrics[key]["value"], made["metrics"][key]["value"])
        for metrics in (record["scores"]["metrics"],)
        for key in CONTINUOUS
        if key in metrics and key in made["metrics"]
    ]
    equal = sum(a == b for a, b in pairs)
    return BITWISE if same and 2 * equal >= len(pairs) else TOLERANCE


def compare_numbers(record: Record, made: dict[str, Any], tier: str) -> list[Verdict]:
    """Return one verdict for each number of a record."""
    made = json.loads(json.dumps(made))
    verdicts = []
    for subject, key, claimed, here in _pairs(record["scores"], made):
        if TIMED.fullmatch(key):
            verdicts.append(unknown(subject, "a time: it depends on the machine", claimed["value"]))
        elif here is None:
            reason = "its judge is not here, or its road does not draw again"
            if key == "success_grader" and not record["scores"].get("extractors"):
                reason = "the record does not say which grader saw it"
            verdicts.append(unknown(subject, reason, claimed["value"]))
        else:
            verdicts.extend(_numbers(subject, key, claimed, here, tier, record["track"]))
    for kind, claimed in record["scores"].get("extractors", {}).items():
        if kind in made.get("extractors", {}):
            here = made["extractors"][kind]
            say = holds if claimed == here else fails
            verdicts.append(say(f"extractors.{kind}.settings", "those that it was scored with"))
    return verdicts


def _pairs(
    claimed: dict[str, Any], made: dict[str, Any]
) -> Iterator[tuple[str, str, dict[str, Any], dict[str, Any] | None]]:
    for key, metric in claimed["metrics"].items():
        yield f"metrics.{key}", key, metric, made["metrics"].get(key)
    for seed, metrics in claimed.get("by_seed", {}).items():
        here = made.get("by_seed", {}).get(seed, {})
        for key, metric in metrics.items():
            yield f"by_seed.{seed}.{key}", key, metric, here.get(key)


def _numbers(
    subject: str, key: str, claimed: dict[str, Any], here: dict[str, Any], tier: str, track: str
) -> Iterator[Verdict]:
    allowed = _tolerance(key, claimed, tier, track)
    doubtful = _doubtful(key, claimed, track) if tier == HALF else 0.0
    for number in NUMBERS:
        stated, value = claimed[number], here[number]
        reason = "equal to the last bit"
        passes = stated == value
        bound = 0.0 if number == "n" or tier == BITWISE else allowed
        if not passes and None not in (stated, value):
            passes = abs(stated - value) <= bound
            reason = f"differs by {abs(stated - value):.2g}"
        elif not passes:
            reason = "one of the two is missing"
        say = holds if passes else fails
        near = None not in (stated, value) and abs(stated - value) <= doubtful
        if not passes and near and number != "n":
            say, reason = unknown, f"{reason}: the full weights would tell"
        verdict = say(f"{subject}.{number}", f"recomputed: {reason}", stated, value)
        yield dataclasses.replace(verdict, tolerance=bound)


def _doubtful(key: str, claimed: dict[str, Any], track: str) -> float:
    """Return what half-precision weights may move a metric by without a word against it."""
    if key in TRACK[track].ranked_by or None in (claimed["low"], claimed["high"]):
        return 0.0
    return (claimed["high"] - claimed["low"]) / 2


def _tolerance(key: str, claimed: dict[str, Any], tier: str, track: str) -> float:
    bound = PRIMARY
    if key not in TRACK[track].ranked_by:
        bound = max(1.0, abs(claimed["value"] or 0.0)) * max(OTHERS, ITEMS / max(claimed["n"], 1))
    if tier == HALF and None not in (claimed["low"], claimed["high"]):
        return max(bound, SHARE * (claimed["high"] - claimed["low"]) / 2)
    return bound
