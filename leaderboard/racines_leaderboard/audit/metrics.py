"""Metrics by themselves: n, intervals and means that cannot be what they say, without scoring."""

import re
from typing import Any

import numpy as np

from racines_data.config import fill, section
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, unknown
from racines_leaderboard.board.collect import Record

OF_VIEW = re.compile(r"(grade_agreement|grade_error|pose_error_(mm|deg)_view)(_truth)?")
"""Metrics over the frames of a view alone."""
PRDC = re.compile(r"(precision|recall|density|coverage)(_grader)?")
TIMED = re.compile(r"images_per_second_(?P<batch>\d+)|latency")
"""Metrics of the machine."""
CLOSE = 1e-9
"""What the last bits of a sum may differ by, relative."""


def check_metrics(record: Record, bench: Bench) -> list[Verdict]:
    """Check each metric's n, interval and parts against one another and the board's settings."""
    scores, verdicts = record["scores"], []
    groups = {"metrics": scores["metrics"]}
    groups |= {f"by_seed.{seed}": each for seed, each in scores.get("by_seed", {}).items()}
    for place, metrics in groups.items():
        counts = _counts(record, bench, place, metrics)
        for key, metric in metrics.items():
            subject = f"{place}.{key}"
            verdicts.append(_interval(f"{subject}.interval", metric))
            if key in counts and not TIMED.fullmatch(key):
                n, reason = counts[key]
                verdicts.append(equal(f"{subject}.n", metric["n"], n, reason))
            verdicts.extend(_parts(subject, metric))
    return verdicts + _methods(record, bench)


def _interval(subject: str, metric: dict[str, Any]) -> Verdict:
    value, low, high = (metric[key] for key in ("value", "low", "high"))
    if (low is None) != (high is None):
        return fails(subject, "one end is missing", [low, high])
    if value is None or low is None:
        return holds(subject, "none given", [low, high])
    slack = CLOSE * max(1.0, abs(value))
    say = holds if low - slack <= value <= high + slack else fails
    return say(subject, "low ≤ value ≤ high", [low, value, high])


def _parts(subject: str, metric: dict[str, Any]) -> list[Verdict]:
    """Check what follows from other numbers of a metric: means of parts, Wilson's interval."""
    settings, verdicts = metric.get("settings", {}), []
    if (sets := settings.get("by_set")) and metric["value"] is not None:
        mean = float(np.mean(sets))
        close = abs(mean - metric["value"]) <= CLOSE * max(1.0, abs(mean))
        say, reason = holds if close else fails, "the mean of its sets"
        verdicts.append(say(f"{subject}.by_set", reason, metric["value"], mean))
    if settings.get("interval") == "Wilson" and metric["n"]:
        verdicts.append(_wilson(f"{subject}.wilson", metric))
    return verdicts


def _wilson(subject: str, metric: dict[str, Any]) -> Verdict:
    from racines_models.statistics import wilson

    n = metric["n"]
    here = wilson(np.arange(n) < round(metric["value"] * n))
    keys = ("value", "low", "high")
    claimed, recomputed = ([one[key] for key in keys] for one in (metric, here))
    say = holds if np.allclose(claimed, recomputed, rtol=0, atol=CLOSE) else fails
    return say(subject, f"a rate of {n} and Wilson's interval for n = {n}", claimed, recomputed)


def _counts(
    record: Record, bench: Bench, place: str, metrics: dict[str, Any]
) -> dict[str, tuple[int, str]]:
    """Return the n that each metric must have, and why, as far as it is known."""
    if record["track"] == "agents":
        return _episodes(record, place, metrics)
    store = bench.data_for(record["scores"]["dataset"]["recipe_digest"])
    if store is None:
        return _at_most(bench, metrics)
    from racines_models.scores.diversity import places_again
    from racines_models.scores.scoring import PRDC_FRAMES

    views = bench.sample.frames.views
    frames = len(views)
    seen = int(((views >= 0) & (views != len(store.labels) - 1)).sum())
    again, scores = len(places_again(frames)), record["scores"]
    # Every run draws as many sets; where each draws one, the first run draws some poses again.
    several = len(scores["seeds"]) > scores.get("runs", 1)
    counts = {}
    for key in metrics:
        n, reason = frames, "frames of the sample"
        if OF_VIEW.fullmatch(key):
            n, reason = seen, "frames of the sample that show a view"
        elif PRDC.fullmatch(key):
            n = min(frames, PRDC_FRAMES)
        elif key == "diversity_truth" or (key == "diversity" and not several):
            n, reason = again, "poses drawn again"
        counts[key] = (n, reason)
    return counts


def _at_most(bench: Bench, metrics: dict[str, Any]) -> dict[str, tuple[int, str]]:
    """Without the data: no metric rests on more frames than the settings score."""
    most = bench.scores.samples
    counts = {key: metric["n"] for key, metric in metrics.items()}
    reason = f"at most {most:,} frames are scored; how many show a view, the data would tell"
    return {key: (min(n, most), reason) for key, n in counts.items()}


def _episodes(record: Record, place: str, metrics: dict[str, Any]) -> dict[str, tuple[int, str]]:
    starts = record["scores"]["task"]["start_set"]
    if not isinstance(starts, dict):
        return {}
    sets = len(starts["seeds"]) if place == "metrics" else 1
    n, counts = sets * starts["starts"], {}
    success = metrics["success_true"]["value"] or 0.0
    for key in metrics:
        counts[key] = (n, "episodes from the start sets")
        if key in ("steps", "steps_median"):
            counts[key] = (round(success * n), "episodes with true success")
    return counts


def _methods(record: Record, bench: Bench) -> list[Verdict]:
    """Check how the intervals say they were made: resamples, blocks and trajectories."""
    if bench.settings is None:
        return [unknown("intervals", f"no settings of board {bench.board} here: give --params")]
    if record["track"] == "agents":
        from racines_envs.evaluation.run import EvaluationConfig

        config = fill(EvaluationConfig, section(bench.settings, "evaluation"), "evaluation")
        wanted = {"resamples": config.resamples}
    else:
        wanted = {"resamples": bench.scores.resamples}
        store = bench.data_for(record["scores"]["dataset"]["recipe_digest"])
        if store is not None:
            trajectories = len(np.unique(bench.sample.trajectory))
            wanted |= {"blocks": min(bench.scores.blocks, trajectories)}
    stated: dict[str, set[int]] = {key: set() for key in wanted}
    for metric in record["scores"]["metrics"].values():
        method = metric.get("settings", {}).get("interval", "")
        for key, numbers in stated.items():
            numbers |= {int(number) for number in re.findall(rf"(\d+) {key}", method)}
    return [
        equal(f"intervals.{key}", sorted(numbers), [wanted[key]], "the board's settings")
        for key, numbers in stated.items()
        if numbers
    ]
