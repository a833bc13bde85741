"""The metrics of a study: how raters' views and grades agree with a reference, or with each other.

The paper counts how often view and grade agree (369 and 350 of 400) and leaves open when two grades
agree. Here they do when they differ by at most one, as in the scores of the grader; how often they
are equal after rounding is told beside it.

Agreement beyond chance is Cohen's kappa, plain and weighted (A coefficient of agreement for nominal
scales, 1960; Weighted kappa, 1968), and Fleiss' kappa of several raters. Intervals resample whole
trajectories, since frames of one sweep are near-copies. Where trajectories are few, many a resample
lacks a view, which moves kappa itself; there they are left out in turn instead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torchmetrics.functional.nominal import fleiss_kappa

from racines_models.judges.grader.report import CLOSE
from racines_models.statistics import LEVEL, bootstrap_mean, jackknife, wilson

GRADES = 11
"""Whole grades, 0 to 10."""
UNIT = "grades of 10"
MANY = 20
"""Fewest trajectories that are resampled; of fewer each is left out in turn."""
Statistic = Callable[[np.ndarray], np.ndarray]
"""Takes (B, C) int64 weights of C trajectories and returns (B,) values."""


@dataclass(frozen=True)
class Answers:
    """Answers to n images, by one (shape (n,)) or by R raters (shape (R, n))."""

    views: np.ndarray
    """int64 labels, -1 where there is no answer."""
    grades: np.ndarray
    """float64 grades 0-10, NaN where there is no answer."""

    def of(self, rows: np.ndarray) -> "Answers":
        """Return the answers to some of the images."""
        return Answers(self.views[..., rows], self.grades[..., rows])

    def alone(self) -> "Answers":
        """Return one rater's (n,) answers as those of R = 1 raters."""
        return Answers(self.views[None], self.grades[None])


def agreement(
    given: Answers, reference: Answers, clusters: np.ndarray, labels: int, resamples: int = 1000
) -> dict[str, Any]:
    """Compare R raters' (R, n) answers with a reference's (n,), images in (n,) trajectories.

    Of the view labels, the last says that there is no view.

    Returns:
        `metrics`, each with value, low, high and n, which counts images; and `confusion`, the
        counts of `views` and of rounded `grades` summed over raters, rows the reference.
    """
    _, cluster = np.unique(clusters, return_inverse=True)
    whole, whole_reference = _whole(given.grades), _whole(reference.grades)
    views = confusion(reference.views, given.views, cluster, labels)
    grades = confusion(whole_reference, whole, cluster, GRADES)
    difference = given.grades - reference.grades
    graded = np.isfinite(difference)
    named = (given.views >= 0) & (reference.views >= 0)
    both = (given.views < labels - 1) & (reference.views < labels - 1)
    of_views = np.where(both, difference, np.nan)

    def rate(agrees: np.ndarray, known: np.ndarray, rule: str) -> dict[str, Any]:
        return _mean(np.where(known, agrees, np.nan), cluster, rule, resamples)

    def average(values: np.ndarray, rule: str) -> dict[str, Any]:
        return _mean(values, cluster, f"{rule}, where both see a view", resamples, UNIT)

    weighted = "Cohen's kappa of the grades, quadratic weights"
    close = f"grades differ by at most {CLOSE:g}"
    metrics = {
        "view_agreement": rate(given.views == reference.views, named, "the same view"),
        "view_kappa": kappa_metric(views, nominal(labels), "Cohen's kappa of the views", resamples),
        "grade_agreement": rate(np.abs(difference) <= CLOSE, graded, close),
        "grade_exact": rate(whole == whole_reference, graded, "grades are equal after rounding"),
        "grade_kappa": kappa_metric(grades, quadratic(GRADES), weighted, resamples),
        "grade_difference": average(of_views, "rater minus reference"),
        "grade_error": average(np.abs(of_views), "absolute difference"),
    }
    for metric in metrics.values():
        metric["settings"] |= {"raters": len(given.views)}
    counts = {"views": views.sum((0, 1)).tolist(), "grades": grades.sum((0, 1)).tolist()}
    return {"metrics": metrics, "confusion": counts}


def round_half_up(grades: np.ndarray) -> np.ndarray:
    """Round grades to whole ones, halves upwards; NaN stays."""
    return np.floor(grades + 0.5)


def _whole(grades: np.ndarray) -> np.ndarray:
    return np.nan_to_num(round_half_up(grades), nan=-1.0).clip(-1, GRADES - 1).astype(np.int64)


def _mean(
    values: np.ndarray, cluster: np.ndarray, rule: str, resamples: int, unit: str | None = None
) -> dict[str, Any]:
    """Return the mean of (R, n) values with an interval: of a rate, without a unit, Wilson's.

    Several raters' answers to one image are not independent: they are averaged first, and n counts
    images. The interval of a bootstrap by trajectory stands in the settings of a rate.
    """
    answered = np.isfinite(values).any(0)
    means = np.asarray(np.nanmean(values[:, answered], 0))
    if len(means):
        estimate = bootstrap_mean(means, cluster[answered], resamples=resamples)
        if unit is not None:
            return estimate.to_json(unit, rule=rule)
        metric = wilson(means)
        interval = {"by_trajectory": [estimate.low, estimate.high]}
        metric["settings"] |= {"rule": rule} | interval | {"trajectories": estimate.clusters}
        return metric
    none = {"value": None, "low": None, "high": None, "n": 0}
    return none | ({"unit": unit} if unit else {}) | {"settings": {"rule": rule}}


def kappa(counts: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return Cohen's kappa of (..., K, K) counts; NaN where chance alone leaves no disagreement.

    `cost` is the (K, K) disagreement of each pair of answers, 0 on the diagonal.
    """
    rows, columns = counts.sum(-1), counts.sum(-2)
    observed = (counts * cost).sum((-2, -1)) * counts.sum((-2, -1))
    chance = np.einsum("...i,ij,...j->...", rows, cost, columns)
    return 1.0 - np.divide(observed, chance, out=np.full(chance.shape, np.nan), where=chance > 0)


def nominal(size: int) -> np.ndarray:
    """Return the cost of views: any two differ as much as any others."""
    return 1.0 - np.eye(size)


def quadratic(size: int) -> np.ndarray:
    """Return the cost of grades: the square of their difference."""
    grades = np.arange(size, dtype=np.float64)
    return np.square(grades[:, None] - grades)


def confusion(
    reference: np.ndarray, given: np.ndarray, groups: np.ndarray, size: int
) -> np.ndarray:
    """Count R raters' (R, n) answers against a reference's (n,) in (n,) groups from 0.

    Answers are int64, 0 to size - 1, or -1 where there is none.

    Returns:
        (R, G, size, size) int64 counts, rows the reference.
    """
    raters, count = given.shape[0], int(groups.max(initial=-1)) + 1
    place = np.broadcast_to(groups, given.shape) + count * np.arange(raters)[:, None]
    pairs = (place * size + np.broadcast_to(reference, given.shape)) * size + given
    both = (given >= 0) & (reference >= 0)
    counts = np.bincount(pairs[both], minlength=raters * count * size**2)
    return counts.reshape(raters, count, size, size)


def kappa_metric(
    counts: np.ndarray, cost: np.ndarray, rule: str, resamples: int = 1000
) -> dict[str, Any]:
    """Return the mean of R raters' kappas with an interval by trajectory.

    `counts` are (R, C, K, K), by rater and trajectory; `rule` says what it is, for its settings.
    """
    n = int(counts.sum((1, 2, 3)).max(initial=0))
    seen = counts[:, counts.sum((0, 2, 3)) > 0]

    def statistic(weights: np.ndarray) -> np.ndarray:
        return kappa(np.einsum("bc,rckl->brkl", weights, seen, optimize=True), cost).mean(1)

    value, count = float(kappa(seen.sum(1), cost).mean()), seen.shape[1]
    return _metric(value, n, statistic, count, resamples, rule=rule, trajectories=count)


def fleiss_metric(
    views: np.ndarray, groups: np.ndarray, size: int, resamples: int = 1000
) -> dict[str, Any]:
    """Return Fleiss' kappa of (R, n) views over the images that all R raters answered."""
    complete = (views >= 0).all(0)
    votes = torch.from_numpy((views[:, complete, None] == np.arange(size)).sum(0))
    unique, cluster = np.unique(groups[complete], return_inverse=True)

    def statistic(weights: np.ndarray) -> np.ndarray:
        rows = [torch.from_numpy(np.repeat(np.arange(len(votes)), w[cluster])) for w in weights]
        return np.array([float(fleiss_kappa(votes[row], mode="counts")) for row in rows])

    value = float(statistic(np.ones((1, len(unique)), np.int64))[0]) if len(votes) else np.nan
    how = {"rule": "Fleiss' kappa of the views", "library": "torchmetrics"}
    return _metric(value, len(votes), statistic, len(unique), resamples, **how)


def _metric(
    value: float, n: int, statistic: Statistic, clusters: int, resamples: int, **settings: Any
) -> dict[str, Any]:
    """Return a value, None if it is not finite, with its interval and how that was made."""
    known = bool(np.isfinite(value))
    low, high, method = _interval(statistic, clusters if known else 0, resamples)
    metric = {"value": value if known else None, "low": low, "high": high, "n": n}
    return metric | {"settings": settings | {"interval": method}}


def _interval(
    statistic: Statistic, clusters: int, resamples: int
) -> tuple[float | None, float | None, str]:
    """Return the ends of a 95 % interval and how it was made."""
    if clusters < 2:
        return None, None, "none: fewer than two trajectories, or no value"
    if clusters < MANY:
        rows = np.arange(clusters)
        left = jackknife(lambda keep: float(statistic(keep[None].astype(np.int64))[0]), rows, MANY)
        if left.low is None or left.high is None or not np.isfinite(left.low):
            return None, None, "none: a trajectory alone holds all but one answer"
        return max(left.low, -1.0), min(left.high, 1.0), left.method
    share = np.full(clusters, 1 / clusters)
    drawn = statistic(np.random.default_rng(0).multinomial(clusters, share, size=resamples))
    low, high = np.quantile(drawn[np.isfinite(drawn)], [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return float(low), float(high), f"percentile bootstrap by trajectory, {resamples} resamples"
