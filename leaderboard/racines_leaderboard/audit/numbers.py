"""Recomputed numbers against those of a record, each within what its tier allows.

bitwise     the same libraries, processor, threads, data and weights: every bit
tolerance   elsewhere: the metrics that rank within 0.0004; the others within 0.001 of their
            size, or two items of n
half        from half-precision weights: the same, or a quarter of the interval's half-width;
            of a metric that does not rank, what is off by more but by less than the half-width
            cannot be told: other weights draw other images
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

from racines_leaderboard.audit.claims import differing
from racines_leaderboard.audit.metrics import TIMED
from racines_leaderboard.audit.roads import HALF
from racines_leaderboard.audit.verdicts import Verdict, fails, holds, tell, unknown
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
    scores = record["scores"]
    same = not differing(scores["environment"], made["environment"])
    if record["track"] == "generators":
        same &= scores["dataset"]["digest"] == made["dataset"]["digest"]
    both = [key for key in CONTINUOUS if key in scores["metrics"] and key in made["metrics"]]
    equal = sum(scores["metrics"][key]["value"] == made["metrics"][key]["value"] for key in both)
    return BITWISE if same and 2 * equal >= len(both) else TOLERANCE


def compare_numbers(record: Record, made: dict[str, Any], tier: str) -> Iterator[Verdict]:
    """Give one verdict for each number of a record; `made` is what was recomputed, as JSON has it.

    The settings of each extractor that took part are compared as well.
    """
    extractors = record["scores"].get("extractors", {})
    for subject, key, claimed, here in _pairs(record["scores"], made):
        if TIMED.fullmatch(key):
            yield unknown(subject, "a time: it depends on the machine", claimed["value"])
        elif here is None:
            reason = "its judge is not here, or its road does not draw again"
            if key == "success_grader" and not extractors:
                reason = "the record does not say which grader saw it"
            yield unknown(subject, reason, claimed["value"])
        else:
            yield from _numbers(subject, key, claimed, here, tier, record["track"])
    for kind, claimed in extractors.items():
        if kind in made.get("extractors", {}):
            same = claimed == made["extractors"][kind]
            yield tell(same, f"extractors.{kind}.settings", "those that it was scored with")


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
    allowed, doubtful = _bounds(key, claimed, tier, track)
    for number in NUMBERS:
        stated, value = claimed[number], here[number]
        bound = 0.0 if number == "n" or tier == BITWISE else allowed
        say, reason = fails, "one of the two is missing"
        if stated == value:
            say, reason = holds, "equal to the last bit"
        elif None not in (stated, value):
            off = abs(stated - value)
            say, reason = holds if off <= bound else fails, f"differs by {off:.2g}"
            if say is fails and off <= doubtful and number != "n":
                say, reason = unknown, f"{reason}: the full weights would tell"
        verdict = say(f"{subject}.{number}", f"recomputed: {reason}", stated, value)
        yield dataclasses.replace(verdict, tolerance=bound)


def _bounds(key: str, claimed: dict[str, Any], tier: str, track: str) -> tuple[float, float]:
    """Return the difference that passes, and the larger one that half precision leaves open."""
    ranks, doubtful = key in TRACK[track].ranked_by, 0.0
    size = max(1.0, abs(claimed["value"] or 0.0))
    bound = PRIMARY if ranks else size * max(OTHERS, ITEMS / max(claimed["n"], 1))
    if tier == HALF and None not in (claimed["low"], claimed["high"]):
        width = claimed["high"] - claimed["low"]
        bound = max(bound, SHARE * width / 2)
        doubtful = 0.0 if ranks else width / 2
    return bound, doubtful
