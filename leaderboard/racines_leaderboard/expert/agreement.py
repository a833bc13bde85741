"""The metrics of a study: how raters' views and grades agree with a reference, or with each other.

The paper counts how often view and grade agree (369 and 350 of 400) and leaves open when two grades
agree. Here they do when they differ by at most one, as in the scores of the grader; how often they
are equal after rounding is told beside it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from racines_leaderboard.expert.kappa import confusion, kappa_metric, nominal, quadratic
from racines_models.judges.grader.report import CLOSE
from racines_models.statistics import bootstrap_mean, wilson

GRADES = 11
"""Whole grades, 0 to 10."""
UNIT = "grades of 10"


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
        return _rate(np.where(known, agrees, np.nan), cluster, rule, resamples)

    def average(values: np.ndarray, rule: str) -> dict[str, Any]:
        return _average(values, cluster, f"{rule}, where both see a view", resamples)

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
    whole = np.nan_to_num(round_half_up(grades), nan=-1.0)
    return whole.clip(-1, GRADES - 1).astype(np.int64)


def _by_image(values: np.ndarray, cluster: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over raters of the images that any of them answered, and their clusters.

    Several raters' answers to one image are not independent; so n counts images.
    """
    answered = np.isfinite(values).any(0)
    return np.asarray(np.nanmean(values[:, answered], 0)), cluster[answered]


def _rate(values: np.ndarray, cluster: np.ndarray, rule: str, resamples: int) -> dict[str, Any]:
    """Return a rate with Wilson's interval; in the settings that of a bootstrap by trajectory."""
    rates, cluster = _by_image(values, cluster)
    metric = wilson(rates)
    metric.setdefault("settings", {})["rule"] = rule
    if len(rates):
        estimate = bootstrap_mean(rates, cluster, resamples=resamples)
        metric["settings"]["by_trajectory"] = [estimate.low, estimate.high]
        metric["settings"]["trajectories"] = estimate.clusters
    return metric


def _average(values: np.ndarray, cluster: np.ndarray, rule: str, resamples: int) -> dict[str, Any]:
    means, cluster = _by_image(values, cluster)
    if not len(means):
        none = {"value": None, "low": None, "high": None, "n": 0, "unit": UNIT}
        return none | {"settings": {"rule": rule}}
    return bootstrap_mean(means, cluster, resamples=resamples).to_json(UNIT, rule=rule)
