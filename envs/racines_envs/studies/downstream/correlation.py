"""Rank correlation of what images score with what a servo learns from them.

A point's metrics are of train patients, and its outcome of validation patients: an interval
resamples both, each patient the same in all points (percentile bootstrap; of metrics, their
pseudo-values about the value). Which points there are, and each servo's one training, are as they
are: the interval says nothing of other points.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from racines_envs.studies.downstream.config import METRICS, SCORED, Anchors
from racines_envs.studies.downstream.points import MEAN, TRUTH
from racines_models.statistics import LEVEL
from racines_models.statistics.ranks import kendall, spearman

SCORE, BOARD = "score", "score_board"
"""The mean of the metrics of `SCORED`, each between two anchors: here the scouts' mean and the
truth; and those of a board."""
PRIMARY = SCORE, "success_declared"
"""The metric and the outcome that the study asks about; all others are told beside."""
OUTCOMES = {"success_declared": 1, "final_grade": 1, "position_error": -1}
"""Outcomes that are correlated, and whether more or less is better."""
FEWEST = 4
"""Points of a group below which a correlation says nothing."""
Row = dict[str, Any]


def add_scores(rows: Sequence[Row], anchors: Anchors | None = None) -> None:
    """Give each point its scores and their pseudo-values, where there are anchors."""
    by_spec = {row["spec"]: row["metrics"] for row in rows}
    if {TRUTH, MEAN} <= set(by_spec):
        ends = [[by_spec[spec][name]["value"] for spec in (MEAN, TRUTH)] for name in SCORED]
        _add_score(rows, SCORE, np.array(ends))
    if anchors is not None and anchors.known:
        _add_score(rows, BOARD, np.array(anchors.ends()))


def _add_score(rows: Sequence[Row], name: str, ends: np.ndarray) -> None:
    """Give each point a score between (M, 2) values of its M metrics."""
    zero, one = ends.T
    for row in rows:
        values = np.array([row["metrics"][each]["value"] for each in SCORED])
        pseudo = np.array([_centred(row, each) for each in SCORED])
        row["metrics"][name] = {"value": float(((values - zero) / (one - zero)).mean())}
        row["pseudo"][name] = ((pseudo - zero[:, None]) / (one - zero)[:, None]).mean(0).tolist()


def _centred(row: Row, metric: str) -> np.ndarray:
    """Return a metric's pseudo-values about its value, which those of a distance are not."""
    value = row["metrics"][metric]["value"]
    pseudo = np.array(row["pseudo"][metric] or [value])  # of one patient there are none
    return pseudo + (value - pseudo.mean())


def correlations(rows: Sequence[Row], resamples: int = 2000) -> list[Row]:
    """Return ρ and τ of every metric with every outcome, over all points and over groups of them.

    Positive where better images teach better servos.
    """
    groups = {"all points": list(rows)}
    groups["generators and floors"] = [row for row in rows if row["kind"] != TRUTH]
    groups["the truth, as it is and made worse"] = [row for row in rows if row["kind"] == TRUTH]
    told = [name for name in (SCORE, BOARD) if all(name in row["metrics"] for row in rows)]
    metrics = dict.fromkeys(told, 1) | METRICS
    return [
        {"points": title, "metric": metric, "outcome": outcome, "n": len(group)}
        | _correlation(group, metric, better, outcome, resamples)
        for title, group in groups.items()
        if len(group) >= FEWEST
        for metric, better in metrics.items()
        for outcome in OUTCOMES
    ]


def _correlation(
    rows: Sequence[Row], metric: str, better: int, outcome: str, resamples: int
) -> dict[str, Any]:
    """Return both rank correlations of a metric with an outcome, over some points."""
    patients = np.array([_centred(row, metric) for row in rows]) * better
    values = np.array([row["metrics"][metric]["value"] for row in rows]) * better
    found = _by_patient(rows, outcome) * OUTCOMES[outcome]
    drawn = [
        _weights(each.shape[1], resamples, n) @ each.T for n, each in enumerate((patients, found))
    ]
    # Rounded, so that what is equal but for the order of a sum ties.
    whole = [np.round(each, 10) for each in (values, found.mean(1))]
    sampled = [np.round(each, 10) for each in drawn]
    rules = {"spearman": spearman, "kendall": kendall}
    return {name: _interval(rule(*whole), rule(*sampled)) for name, rule in rules.items()}


def _by_patient(rows: Sequence[Row], outcome: str) -> np.ndarray:
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
    """Return a correlation with its percentile interval; no value where a side is flat.

    Draws in which a side is flat are left out and counted.
    """
    defined = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or not len(defined):
        return {"value": None, "low": None, "high": None, "undefined": len(drawn) - len(defined)}
    low, high = np.quantile(defined, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    told = {"value": float(value), "low": float(low), "high": float(high)}
    return told | {"undefined": len(drawn) - len(defined)}
