"""Rank correlation of what images score with what a servo learns from them.

A point's metrics are of train patients, and its outcome of validation patients: an interval
resamples both, each patient the same in all points (percentile bootstrap). Which points there are,
and each servo's one training, are as they are: the interval says nothing of other points.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from racines_envs.studies.downstream.points import MEAN, TRUTH
from racines_envs.studies.downstream.run import METRICS
from racines_envs.studies.transfer import kendall, spearman
from racines_models.statistics import LEVEL

SCORE = "score"
"""The board's: the mean of its metrics between two anchors, here the scouts' mean and the truth."""
PRIMARY = SCORE, "success_declared"
"""The metric and the outcome that the study asks about; all others are told beside."""
SCORED = ("ssim", "psnr", "kid", "pose_error_mm", "dice")
"""Metrics of the score."""
OUTCOMES = {"success_declared": 1, "final_grade": 1, "position_error": -1}
"""Outcomes that are correlated, and whether more or less is better."""
FEWEST = 4
"""Points of a group below which a correlation says nothing."""


def add_scores(rows: Sequence[dict[str, Any]]) -> bool:
    """Give each point its score and the score's pseudo-values; False where an anchor is missing."""
    by_spec = {row["spec"]: row for row in rows}
    if not {TRUTH, MEAN} <= set(by_spec):
        return False
    ends = [[by_spec[spec]["metrics"][name]["value"] for name in SCORED] for spec in (MEAN, TRUTH)]
    zero, one = np.array(ends)
    for row in rows:
        pseudo = np.array([row["pseudo"][name] for name in SCORED])
        row["pseudo"][SCORE] = ((pseudo - zero[:, None]) / (one - zero)[:, None]).mean(0).tolist()
        values = np.array([row["metrics"][name]["value"] for name in SCORED])
        row["metrics"][SCORE] = {"value": float(((values - zero) / (one - zero)).mean())}
    return True


def correlations(rows: Sequence[dict[str, Any]], resamples: int = 2000) -> list[dict[str, Any]]:
    """Return ρ and τ of every metric with every outcome, over all points and over groups of them.

    Positive where better images teach better servos.
    """
    groups = {"all points": list(rows)}
    groups["generators"] = [row for row in rows if row["kind"] != TRUTH]
    groups["the truth made worse"] = [row for row in rows if row["kind"] == TRUTH]
    metrics = {**({SCORE: 1} if all(SCORE in row["metrics"] for row in rows) else {}), **METRICS}
    found = []
    for title, group in groups.items():
        if len(group) < FEWEST:
            continue
        for metric, better in metrics.items():
            drawn = _drawn_metric(group, metric, resamples) * better
            whole = np.array([row["metrics"][metric]["value"] for row in group]) * better
            for outcome, best in OUTCOMES.items():
                told = {"points": title, "metric": metric, "outcome": outcome, "n": len(group)}
                ends = _by_patient(group, outcome).mean(1) * best
                rules = {"spearman": spearman, "kendall": kendall}
                sampled = _drawn_outcome(group, outcome, resamples) * best
                told |= {
                    name: _interval(rule(_r(whole), _r(ends)), rule(_r(drawn), _r(sampled)))
                    for name, rule in rules.items()
                }
                found.append(told)
    return found


def _r(values: np.ndarray) -> np.ndarray:
    """Round, so that what is equal but for the order of a sum ties."""
    return np.round(values, 10)


def _drawn_metric(rows: Sequence[dict[str, Any]], metric: str, resamples: int) -> np.ndarray:
    """Return (resamples, points) values of a metric on train patients drawn anew."""
    pseudo = np.array([row["pseudo"][metric] for row in rows])
    return (_weights(pseudo.shape[1], resamples, 0) @ pseudo.T).astype(np.float64)


def _drawn_outcome(rows: Sequence[dict[str, Any]], outcome: str, resamples: int) -> np.ndarray:
    """Return (resamples, points) values of an outcome on the patients judged on, drawn anew."""
    values = _by_patient(rows, outcome)
    return (_weights(values.shape[1], resamples, 1) @ values.T).astype(np.float64)


def _by_patient(rows: Sequence[dict[str, Any]], outcome: str) -> np.ndarray:
    """Return (points, patients) means of an outcome over views, trainings and starts."""
    found = []
    for row in rows:
        units = np.array(row["found"]["patients"])
        views = [each[outcome] for name, each in row["found"].items() if name != "patients"]
        values = np.array(views).mean((0, 1))
        found.append([values[units == unit].mean() for unit in dict.fromkeys(units.tolist())])
    return np.array(found)


def _weights(units: int, resamples: int, stream: int) -> np.ndarray:
    """Return (resamples, units) shares of each unit in draws with replacement."""
    drawn = np.random.default_rng(stream).integers(0, units, (resamples, units))
    return np.stack([np.bincount(row, minlength=units) for row in drawn]) / units


def _interval(value: Any, drawn: np.ndarray) -> dict[str, Any]:
    """Return a correlation with its percentile interval; no value where a side is flat."""
    if not np.isfinite(value):
        return {"value": None, "low": None, "high": None}
    defined = drawn[np.isfinite(drawn)]
    low, high = np.quantile(defined, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return {"value": float(value), "low": float(low), "high": float(high)}
