"""Metrics by themselves: n, intervals and means that cannot be what they say, without scoring."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, tell, unknown
from racines_leaderboard.board.collect import Record

OF_VIEW = re.compile(r"(grade_agreement|grade_error|pose_error_(mm|deg)_view)(_truth)?")
"""Metrics over the frames of a view alone."""
PRDC = re.compile(r"(precision|recall|density|coverage)(_grader)?")
TIMED = re.compile(r"images_per_second_(?P<batch>\d+)|latency")
"""Metrics of the machine."""
CLOSE = 1e-9
"""What the last bits of a sum may differ by, relative."""
ENDS = ("value", "low", "high")


def check_metrics(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check each metric's n, interval and parts against one another and the board's settings."""
    scores = record["scores"]
    groups = {"metrics": scores["metrics"]}
    groups |= {f"by_seed.{seed}": each for seed, each in scores.get("by_seed", {}).items()}
    for place, metrics in groups.items():
        counts = _counts(record, bench, place, metrics)
        for key, metric in metrics.items():
            subject = f"{place}.{key}"
            yield _interval(f"{subject}.interval", metric)
            if key in counts and not TIMED.fullmatch(key):
                n, reason = counts[key]
                yield equal(f"{subject}.n", metric["n"], n, reason)
            yield from _parts(subject, metric)
    yield from _methods(record, bench)


def _interval(subject: str, metric: dict[str, Any]) -> Verdict:
    value, low, high = (metric[key] for key in ENDS)
    if (low is None) != (high is None):
        return fails(subject, "one end is missing", [low, high])
    if value is None or low is None:
        return holds(subject, "none given", [low, high])
    slack = CLOSE * max(1.0, abs(value))
    inside = low - slack <= value <= high + slack
    return tell(inside, subject, "low ≤ value ≤ high", [low, value, high])


def _parts(subject: str, metric: dict[str, Any]) -> Iterator[Verdict]:
    """Check what follows from other numbers of a metric: means of parts, Wilson's interval."""
    settings, value, n = metric.get("settings", {}), metric["value"], metric["n"]
    if (sets := settings.get("by_set")) and value is not None:
        mean = float(np.mean(sets))
        close = abs(mean - value) <= CLOSE * max(1.0, abs(mean))
        yield tell(close, f"{subject}.by_set", "the mean of its sets", value, mean)
    if settings.get("interval") == "Wilson" and n:
        from racines_models.statistics import wilson

        here = wilson(np.arange(n) < round(value * n))
        claimed, recomputed = ([one[key] for key in ENDS] for one in (metric, here))
        close = np.allclose(claimed, recomputed, rtol=0, atol=CLOSE)
        reason = f"a rate of {n} and Wilson's interval for n = {n}"
        yield tell(close, f"{subject}.wilson", reason, claimed, recomputed)


def _counts(
    record: Record, bench: Bench, place: str, metrics: dict[str, Any]
) -> dict[str, tuple[int, str]]:
    """Return the n that each metric must have, and why, as far as it is known."""
    if record["track"] == "agents":
        return _episodes(record, place, metrics)
    store = bench.data_for(record["scores"]["dataset"]["recipe_digest"])
    if store is None:
        most = bench.scores.samples
        reason = f"at most {most:,} frames are scored; how many show a view, the data would tell"
        return {key: (min(metric["n"], most), reason) for key, metric in metrics.items()}
    from racines_models.scores.diversity import places_again
    from racines_models.scores.judge import PRDC_FRAMES

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
            n, reason = len(places_again(frames)), "poses drawn again"
        counts[key] = (n, reason)
    return counts


def _episodes(record: Record, place: str, metrics: dict[str, Any]) -> dict[str, tuple[int, str]]:
    starts = record["scores"]["task"]["start_set"]
    if not isinstance(starts, dict):
        return {}
    n = (len(starts["seeds"]) if place == "metrics" else 1) * starts["starts"]
    successes = round((metrics["success_true"]["value"] or 0.0) * n)
    counts = dict.fromkeys(metrics, (n, "episodes from the start sets"))
    timed = counts.keys() & {"steps", "steps_median"}
    return counts | dict.fromkeys(timed, (successes, "episodes with true success"))


def _methods(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check how the intervals say they were made: resamples, blocks and trajectories."""
    if bench.settings is None:
        yield unknown("intervals", bench.no_settings)
        return
    if record["track"] == "agents":
        wanted = {"resamples": bench.evaluation.resamples}
    else:
        wanted = {"resamples": bench.scores.resamples}
        if bench.data_for(record["scores"]["dataset"]["recipe_digest"]) is not None:
            trajectories = len(np.unique(bench.sample.trajectory))
            wanted |= {"blocks": min(bench.scores.blocks, trajectories)}
    metrics = record["scores"]["metrics"].values()
    methods = " ".join(metric.get("settings", {}).get("interval", "") for metric in metrics)
    for key, number in wanted.items():
        if stated := {int(each) for each in re.findall(rf"(\d+) {key}", methods)}:
            yield equal(f"intervals.{key}", sorted(stated), [number], "the board's settings")
