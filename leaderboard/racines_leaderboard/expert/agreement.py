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
    """Compare R raters' answers with a reference.

    Args:
        given: (R, n) answers.
        reference: (n,) answers.
        clusters: (n,) trajectory of each image, an integer.
        labels: Number of view labels; the last says that there is no view.
        resamples: Bootstrap resamples.

    Returns:
        `metrics`, each with value, low, high and n, which counts images; and `confusion`, the
        counts of `views` and of rounded `grades` summed over raters, rows the reference.
    """
    _, cluster = np.unique(clusters, return_inverse=True)
    settings = {"raters": len(given.views)}
    views = confusion(reference.views, given.views, cluster, labels)
    grades = confusion(_whole(reference.grades), _whole(given.grades), cluster, GRADES)
    difference = given.grades - reference.grades
    both = (given.views < labels - 1) & (reference.views < labels - 1)
    difference_of_views = np.where(both, difference, np.nan)
    known = (given.views >= 0) & (reference.views >= 0)
    equal = _whole(given.grades) == _whole(reference.grades)
    metrics = {
        "view_agreement": _rate(
            np.where(known, given.views == reference.views, np.nan),
            cluster,
            "the same view",
            resamples,
        ),
        "view_kappa": kappa_metric(views, nominal(labels), "Cohen's kappa of the views", resamples),
        "grade_agreement": _rate(
            _where_known(np.abs(difference) <= CLOSE, difference),
            cluster,
            f"grades differ by at most {CLOSE:g}",
            resamples,
        ),
        "grade_exact": _rate(
            _where_known(equal, difference), cluster, "grades are equal after rounding", resamples
        ),
        "grade_kappa": kappa_metric(
            grades, quadratic(GRADES), "Cohen's kappa of the grades, quadratic weights", resamples
        ),
        "grade_difference": _average(
            difference_of_views, cluster, "rater minus reference, where both see a view", resamples
        ),
        "grade_error": _average(
            np.abs(difference_of_views),
            cluster,
            "absolute difference, where both see a view",
            resamples,
        ),
    }
    for metric in metrics.values():
        metric["settings"] |= settings
    counts = {"views": views.sum((0, 1)).tolist(), "grades": grades.sum((0, 1)).tolist()}
    return {"metrics": metrics, "confusion": counts}


def round_half_up(grades: np.ndarray) -> np.ndarray:
    """Round grades to whole ones, halves upwards; NaN stays."""
    return np.floor(grades + 0.5)


def _whole(grades: np.ndarray) -> np.ndarray:
    whole = np.nan_to_num(round_half_up(grades), nan=-1.0)
    return whole.clip(-1, GRADES - 1).astype(np.int64)


def _where_known(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(known), values, np.nan)


def _by_image(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over raters of the images that any of them answered, and which they are."""
    answered = np.isfinite(values).any(0)
    return np.asarray(np.nanmean(values[:, answered], 0)), np.asarray(answered)


def _rate(values: np.ndarray, cluster: np.ndarray, rule: str, resamples: int) -> dict[str, Any]:
    """Return a rate with Wilson's interval; in the settings that of a bootstrap by trajectory.

    Several raters' answers to one image are averaged first, and n counts images: their answers are
    not independent.
    """
    rates, answered = _by_image(values)
    metric = wilson(rates)
    metric.setdefault("settings", {})["rule"] = rule
    if len(rates):
        estimate = bootstrap_mean(rates, cluster[answered], resamples=resamples)
        metric["settings"]["by_trajectory"] = [estimate.low, estimate.high]
        metric["settings"]["trajectories"] = estimate.clusters
    return metric


def _average(values: np.ndarray, cluster: np.ndarray, rule: str, resamples: int) -> dict[str, Any]:
    means, answered = _by_image(values)
    if not len(means):
        none = {"value": None, "low": None, "high": None, "n": 0, "unit": UNIT}
        return none | {"settings": {"rule": rule}}
    estimate = bootstrap_mean(means, cluster[answered], resamples=resamples)
    return estimate.to_json(UNIT, rule=rule)
