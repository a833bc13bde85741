"""The numbers of a record: by themselves, and against those that were recomputed.

By themselves: n, intervals and means that cannot be what they say. Recomputed, each must come
within what its tier allows:

bitwise     the same libraries, processor, threads, data and weights: every bit, but for rounding,
            since names of processors are coarse and each sums in an order of its own; where a
            number differs by that, the report says `rounding`
tolerance   elsewhere: the metrics that rank within 0.0004, or 0.01 where they are errors in mm or
            degrees of estimated motion; the others within 0.001 of their size, or two items of n
half        from half-precision weights: the same, or a quarter of the interval's half-width;
            of a metric that does not rank, what is off by more but by less than the half-width
            cannot be told: other weights draw other images
"""

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from racines_leaderboard.audit import moving
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.claims import differing, judge_of
from racines_leaderboard.audit.verdicts import (
    DIFFERS,
    Verdict,
    equal,
    fails,
    holds,
    tell,
    told,
    unknown,
)
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.ranges import CLOSE, ENDS, RANGES, faults
from racines_leaderboard.records.tracks import PATIENT_GENERATORS, TRACK
from racines_models.scores import diversity
from racines_models.scores.scoring import PRDC_FRAMES
from racines_models.statistics import wilson

OF_VIEW = re.compile(r"(grade_agreement|grade_error|pose_error_(mm|deg)_view)(_truth)?")
"""Metrics over the frames of a view alone."""
PRDC = re.compile(r"(precision|recall|density|coverage)(_grader)?")
TIMED = re.compile(r"images_per_second_(?P<batch>\d+)|latency|seconds_to_adapt")
"""Metrics of the machine."""
BITWISE, ROUNDING, TOLERANCE, HALF = "bitwise", "rounding", "tolerance", "half precision"
PRIMARY = 4e-4
"""Of the metrics that rank, in their own unit: below half of 0.001."""
MILLIMETRES = 1e-2
"""Likewise where those are errors in mm or degrees, of which a tenth is shown."""
OTHERS, ITEMS = 1e-3, 2.0
SHARE = 0.25
"""Of the half-width of an interval, for half-precision weights."""
SUMMED = 1e-12
"""What the order of a sum of doubles may change, of a value's size, or of 1 if it is less; of what
is computed of many, `CLOSE`."""
DISTANCES = re.compile(r"(fid|kid)(_.+)?")
"""Of eigenvalues and of cubes: rounding grows."""
NUMBERS = (*ENDS, "n")
CONTINUOUS = ("ssim", "psnr", "fid", "kid", "final_grade", "spl", "position_error", "return",
              "gpe", "gle", "lpe", "lle",
              "drift_mm", "drift_deg", "step_mm", "step_deg")  # fmt: skip
"""Figures that are equal to the last bit by no accident."""


def check_metrics(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check each metric's n, interval and parts against one another and the board's settings."""
    for place, metrics in _groups(record["scores"]).items():
        counts = _counts(record, bench, place, metrics)
        for key, metric in metrics.items():
            count = None if TIMED.fullmatch(key) else counts.get(key)
            if (own := metric.get("settings", {}).get("by_set")) is not None:
                drawn = max(len(record["scores"]["seeds"]), record["scores"].get("runs", 1))
                yield equal(f"{place}.{key}.by_set.n", len(own), drawn, "sets that were drawn")
            yield from _by_itself(f"{place}.{key}", metric, count)
    yield from _methods(record, bench)
    yield from _strata(record)


def _strata(record: Record) -> Iterator[Verdict]:
    """Check that the strata together have the items of the whole."""
    strata = record["scores"].get("by_stratum", {}).values()
    for key in dict.fromkeys(key for each in strata for key in each):
        if key in record["scores"]["metrics"]:
            found = sum(each[key]["n"] for each in strata if key in each)
            whole = record["scores"]["metrics"][key]["n"]
            yield equal(f"by_stratum.{key}.n", found, whole, "n of all frames")


def _groups(scores: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the metrics by place: those of all runs together, of each seed or pathology."""
    parts = {
        f"{kind}.{name}": each
        for kind in ("by_seed", "by_pathology", "by_stratum")
        for name, each in scores.get(kind, {}).items()
    }
    return {"metrics": scores["metrics"]} | parts


def _by_itself(
    subject: str, metric: dict[str, Any], count: tuple[int, str] | None
) -> Iterator[Verdict]:
    """Check a metric's interval, its n where it is known, and what follows from other numbers."""
    value, low, high = (metric[key] for key in ENDS)
    settings, n = metric.get("settings", {}), metric["n"]
    wrong = dict(faults(subject.rpartition(".")[2], metric))
    for field, reason in wrong.items():
        yield fails(f"{subject}.{field}", reason, metric[field])
    if not wrong:
        told = "none given" if None in (value, low) else "low ≤ value ≤ high, all within its range"
        yield holds(f"{subject}.interval", told, [low, value, high])
    if count is not None:
        yield equal(f"{subject}.n", n, *count)
    if (sets := settings.get("by_set")) and value is not None:
        mean = float(np.mean(sets))
        close = abs(mean - value) <= CLOSE * max(1.0, abs(mean))
        yield tell(close, f"{subject}.by_set", "the mean of its sets", value, mean)
    if settings.get("interval") == "Wilson" and n:
        here = wilson(np.arange(n) < round(value * n))
        claimed, recomputed = ([one[key] for key in ENDS] for one in (metric, here))
        close = np.allclose(claimed, recomputed, rtol=0, atol=CLOSE)
        reason = f"a rate of {n} and Wilson's interval for n = {n}"
        yield tell(close, f"{subject}.wilson", reason, claimed, recomputed)


def _counts(
    record: Record, bench: Bench, place: str, metrics: dict[str, Any]
) -> dict[str, tuple[int, str]]:
    """Return the n that each metric must have, and why, as far as it is known."""
    if TRACK[record["track"]].steers:
        return _episodes(record, place, metrics)
    if record["track"] == PATIENT_GENERATORS.name:
        return {}  # of which frames each is, its evidence tells
    if record["track"] in MOVING:
        return moving.counts(record, bench)
    if bench.settings is None or place.startswith("by_stratum"):
        return {}  # how many frames are scored, or lie in a stratum, is not known
    store = bench.data_for(record)
    if store is None:
        most = bench.scores.samples
        reason = f"at most {most:,} frames are scored; how many show a view, the data would tell"
        return {key: (min(metric["n"], most), reason) for key, metric in metrics.items()}
    views = bench.sample.frames.views
    frames, scores = len(views), record["scores"]
    # Every run draws as many sets; where each draws one, the first run draws some poses again.
    several = len(scores["seeds"]) > scores.get("runs", 1)
    counts = {}
    for key in metrics:
        n, reason = frames, "frames of the sample"
        if OF_VIEW.fullmatch(key):
            n = int(((views >= 0) & (views != len(store.labels) - 1)).sum())
            reason = "frames of the sample that show a view"
        elif PRDC.fullmatch(key):
            n = min(frames, PRDC_FRAMES)
        elif key == "diversity_truth" or (key == "diversity" and not several):
            n, reason = min(frames, diversity.FRAMES), "poses drawn again"
        counts[key] = (n, reason)
    return counts


def starts_of(record: Record) -> tuple[int, int] | None:
    """Return how many start sets an agent's record names, of how many starts; None if none."""
    told = record["scores"]["task"]["start_set"]
    seeds, starts, patients = (
        told.get(key) if isinstance(told, dict) else None for key in ("seeds", "starts", "patients")
    )
    if not isinstance(seeds, list) or not isinstance(starts, int):
        return None
    return len(seeds), starts * (patients if isinstance(patients, int) else 1)


def _episodes(record: Record, place: str, metrics: dict[str, Any]) -> dict[str, tuple[int, str]]:
    if (starts := starts_of(record)) is None or place.startswith("by_pathology"):
        return {}
    n = (starts[0] if place == "metrics" else 1) * starts[1]
    successes = round((metrics["success_true"]["value"] or 0.0) * n)
    counts: dict[str, tuple[int, str]] = dict.fromkeys(metrics, (n, "episodes from the start sets"))
    for key in counts.keys() & {"steps", "steps_median"}:
        counts[key] = (successes, "episodes with true success")
        if metrics[key]["value"] is None:
            counts[key] = (0, "no episode has one")
        elif record["scores"].get("runs", 1) > 1:
            del counts[key]  # that of the training with the fewest successes: the evidence tells
    return counts


def _methods(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check how the intervals say they were made: resamples, blocks and trajectories."""
    if bench.settings is None:
        yield unknown("intervals", bench.no_settings)
        return
    if TRACK[record["track"]].steers:
        wanted = {"resamples": bench.evaluation.resamples}
    else:
        wanted = {"resamples": bench.scores.resamples}
        if bench.data_for(record) is not None:
            wanted |= {"blocks": min(bench.scores.blocks, len(np.unique(bench.sample.trajectory)))}
    metrics = record["scores"]["metrics"].values()
    methods = " ".join(str(metric.get("settings", {}).get("interval", "")) for metric in metrics)
    for key, number in wanted.items():
        if stated := {int(each) for each in re.findall(rf"(\d+) {key}", methods)}:
            yield equal(f"intervals.{key}", sorted(stated), [number], "the board's settings")


def agreement(record: Record, made: dict[str, Any], road: str) -> str:
    """Return how near the numbers must come: `bitwise`, `tolerance` or `half precision`.

    The name of a processor does not tell all of it. Where the machines are the same by name and
    not half of the continuous metrics are equal but for rounding, they are not the same.
    """
    if road == HALF:
        return HALF
    scores = record["scores"]
    same = not differing(scores["environment"], made["environment"])
    there, here = scores["metrics"], made["metrics"]
    both = [key for key in CONTINUOUS if key in there and key in here]
    exact = [key for key in both if _alike(key, there[key]["value"], here[key]["value"])]
    return BITWISE if same and 2 * len(exact) >= len(both) else TOLERANCE


def _alike(key: str, stated: float | None, value: float | None) -> bool:
    if stated is None or value is None:
        return stated == value
    return abs(stated - value) <= _rounding(value, _share(key, "value"))


def compare_numbers(record: Record, made: dict[str, Any], tier: str) -> Iterator[Verdict]:
    """Hold each number of a record, and the settings of its extractors, to what was made again."""
    extractors, there = record["scores"].get("extractors", {}), _groups(made)
    for place, metrics in _groups(record["scores"]).items():
        for key, claimed in metrics.items():
            subject, here = f"{place}.{key}", there.get(place, {}).get(key)
            if TIMED.fullmatch(key):
                yield told(subject, "a time: it depends on the machine", claimed["value"])
            elif here is not None:
                yield from _numbers(subject, key, claimed, here, tier, record["track"])
            elif (judge := judge_of(key)) and judge not in made.get("extractors", {}):
                yield unknown(subject, f"its {judge} is not here", claimed["value"])
            elif any(re.fullmatch(name, key) for name in RANGES):
                yield fails(subject, "there is none when it is made again", claimed["value"])
            else:
                reason = "a metric of a package that is not here"
                yield unknown(f"package.{subject}", reason, claimed["value"])
    for kind, claimed in extractors.items():
        if kind in made.get("extractors", {}):
            same = claimed == made["extractors"][kind]
            yield tell(same, f"extractors.{kind}.settings", "those that it was scored with")
    if "guide" in made.get("extractors", {}) and "guide" not in extractors:
        yield fails("extractors.guide", "made again, it goes by one, and the record names none")


def _numbers(
    subject: str, key: str, claimed: dict[str, Any], here: dict[str, Any], tier: str, track: str
) -> Iterator[Verdict]:
    allowed, doubtful = bounds_of(key, here, tier, track)
    for number in NUMBERS:
        stated, value = claimed[number], here[number]
        bound = _rounding(value, _share(key, number)) if tier == BITWISE else allowed
        bound = 0.0 if number == "n" else bound
        say, reason = fails, "one of the two is missing"
        if stated == value:
            say, reason = holds, "equal to the last bit"
        elif None not in (stated, value):
            off = abs(stated - value)
            say, reason = holds if off <= bound else fails, f"{DIFFERS} {off:.2g}"
            if say is fails and off <= doubtful and number != "n":
                say, reason = unknown, f"{reason}: the full weights would tell"
        verdict = say(f"{subject}.{number}", f"recomputed: {reason}", stated, value)
        yield dataclasses.replace(verdict, tolerance=bound)


def _rounding(value: float | None, share: float) -> float:
    return share * max(1.0, abs(value or 0.0))


def _share(key: str, number: str) -> float:
    """Return what rounding may change: little of a sum, more where much is computed of sums."""
    return CLOSE if number in ENDS[1:] or DISTANCES.fullmatch(key) else SUMMED


def bounds_of(key: str, here: dict[str, Any], tier: str, track: str) -> tuple[float, float]:
    """Return the difference that passes, and the larger one that half precision leaves open.

    Both go by what was made again, so that no claim widens what it is held to.
    """
    ranks, doubtful = key in TRACK[track].ranked_by, 0.0
    size = max(1.0, abs(here["value"] or 0.0))
    primary = MILLIMETRES if track in MOVING else PRIMARY
    bound = primary if ranks else size * max(OTHERS, ITEMS / max(here["n"], 1))
    if tier == HALF and None not in (here["low"], here["high"]):
        width = here["high"] - here["low"]
        bound = max(bound, SHARE * width / 2)
        doubtful = 0.0 if ranks else width / 2
    return bound, doubtful


def bounds_by_metric(made: dict[str, Any], tier: str, track: str) -> dict[str, float]:
    """Return the difference that passes of each metric, and of the parts of a record."""
    metrics = made["metrics"].items()
    if tier == BITWISE:
        bounds = {key: _rounding(here["value"], _share(key, "value")) for key, here in metrics}
    else:
        bounds = {key: bounds_of(key, here, tier, track)[0] for key, here in metrics}
    explained = SUMMED if tier == BITWISE else OTHERS
    return bounds | ({"explained": explained} if track in MOVING else {})
