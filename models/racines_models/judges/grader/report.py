"""How a grader's labels, grades and confidence compare with the truth, on held-out frames.

Temperature scaling and the expected calibration error are after Guo et al., On Calibration of
Modern Neural Networks (2017): one number divides the logits, so no label changes.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from racines_data.store.frames import Batch, FrameStore
from racines_data.views import LABELS, RANDOM_LABEL
from racines_models.judges.grader.model import Grader, Reading
from racines_models.statistics import (
    Interval,
    interval,
    mean_interval,
    rate_interval,
    set_replicates,
)

CLOSE = 1.0
"""Grades that differ by no more agree."""
UNIT = "grades of 10"
MOST = 10.0
"""The best grade, and so the largest error of one."""
BINS = 15
"""Bins of equal width in confidence."""
LIMIT = 10.0
"""Largest temperature that is looked for, and the inverse of the smallest."""


class Comparison(NamedTuple):
    """One figure's value on each frame."""

    values: Tensor
    """(N,) float64, NaN where the truth is unknown or the figure does not apply."""
    rule: str
    unit: str | None = None
    statistic: str = "rate"
    """`rate` of frames, or `mean` of amounts from 0 to `MOST`."""

    def mean(self, units: np.ndarray) -> dict[str, Any]:
        """Return the figure as JSON, with its interval by (N,) units."""
        values = self.values.numpy()
        rate = self.statistic == "rate"
        found = rate_interval(values, units) if rate else _error(values, units)
        return found.to_json(self.unit, rule=self.rule)


def _error(values: np.ndarray, units: np.ndarray) -> Interval:
    return mean_interval(values, units, 0.0, MOST)


def compare(
    label: Tensor, grade: Tensor, views: Tensor, grades: Tensor, random: int = RANDOM_LABEL
) -> dict[str, Comparison]:
    """Compare (N,) labels and grades with the true ones; a figure without any truth is absent.

    `random` is the label of `Random`, whose grades say nothing.
    """
    known = views >= 0
    target = known & (views != random)
    error = (grade - grades).abs().double()
    of_view = torch.where(target, error, torch.nan)
    close = torch.where(of_view.isfinite(), (of_view <= CLOSE).double(), torch.nan)
    right = torch.where(known, (label == views).double(), torch.nan)
    same, near = "the grader's label is the true one", f"grades differ by at most {CLOSE:g}"
    apart = "mean absolute difference"
    compared = {
        "view_agreement": Comparison(right, same),
        "grade_agreement": Comparison(close, f"{near}, frames of a view"),
        "grade_error": Comparison(of_view, f"{apart}, frames of a view", UNIT, "mean"),
        "grade_error_all": Comparison(error, f"{apart}, all frames", UNIT, "mean"),
    }
    return {k: each for k, each in compared.items() if bool(each.values.isfinite().any())}


class Examination(NamedTuple):
    """A grader, its answers on the frames of a split, and what they come to: see `examine`."""

    grader: Grader
    frames: Batch
    reading: Reading
    content: dict[str, Any]


def examine(grader: Grader, store: FrameStore, split: str = "test") -> Examination:
    """Judge a split and compare with its labels, which the grader must have been trained for.

    Returns:
        As `content`, `split`; `metrics`: `view_accuracy`, `balanced_accuracy` (the mean over
        labels), `grade_mae` (frames of a view), `grade_mae_all`, `grade_agreement`, each with
        value, low, high, n; `views`: the accuracy on each label's frames; `grades`: `mae` and
        `bias` on each view's frames; of patients `pathologies`: the metrics of each one's frames;
        `calibration`: the temperature and the expected calibration error `before` and `after` it;
        `confusion`: counts, rows the truth. Units of intervals are patients, or trajectories.
    """
    grader.check_labels(store.labels, "the dataset")
    rows = store.split_indices(split)
    frames = store.take(rows)
    reading = grader.read(frames.images)
    label, units = reading.logits.argmax(-1), store.units(rows)
    labels, names = len(store.labels), {"view_agreement": "view_accuracy"}
    names |= {"grade_error": "grade_mae", "grade_error_all": "grade_mae_all"}
    compared = compare(label, reading.grades, frames.views, frames.grades, labels - 1)
    counts = confusion_counts(label, frames.views, labels)
    calibration: dict[str, Any] = {"temperature": grader.temperature}
    if bool((frames.views >= 0).any()):
        for when, temperature in (("before", 1.0), ("after", grader.temperature)):
            probabilities = (reading.logits / temperature).softmax(-1)
            calibration[when] = calibration_error(probabilities, frames.views, units)
    metrics = {names.get(k, k): each.mean(units) for k, each in compared.items()}
    if "view_agreement" in compared:
        right = compared["view_agreement"].values
        metrics["balanced_accuracy"] = balanced_accuracy(right, frames.views, units)
    content = {
        "split": split,
        "metrics": metrics,
        **_by_view(compared, reading.grades, frames, store),
        **_by_pathology(compared, frames, store, names),
        "calibration": calibration,
        "confusion": {"labels": list(store.labels), "counts": counts},
    }
    return Examination(grader, frames, reading, content)


def _by_view(
    compared: dict[str, Comparison], grades: Tensor, frames: Batch, store: FrameStore
) -> dict[str, Any]:
    """Return `views`, the accuracy by label, and `grades`, the errors by view."""
    views, errors = {}, {}
    units = store.units(frames.index)
    difference, graded = (grades - frames.grades).double().numpy(), frames.grades.isfinite()
    for index, name in enumerate(store.labels):
        shown = frames.views == index
        if bool(shown.any()):
            right = compared["view_agreement"].values[shown].numpy()
            views[name] = rate_interval(right, units[shown.numpy()]).to_json()
        chosen = (shown & graded).numpy()
        if chosen.any() and name != store.labels[-1]:
            signed, clusters = difference[chosen], units[chosen]
            errors[name] = {
                "mae": _error(np.abs(signed), clusters).to_json(UNIT),
                "bias": mean_interval(signed, clusters, -MOST, MOST).to_json(UNIT),
            }
    return {"views": views, "grades": errors}


def _by_pathology(
    compared: dict[str, Comparison], frames: Batch, store: FrameStore, names: dict[str, str]
) -> dict[str, Any]:
    """Return `pathologies`, the metrics by pathology; nothing where no patients are scanned."""
    if store.patients is None:
        return {}
    sick, units = store.pathologies(frames.index), store.units(frames.index)
    told: dict[str, Any] = {}
    for name in np.unique(sick).tolist():
        chosen = torch.from_numpy(sick == name)
        parts = {key: each._replace(values=each.values[chosen]) for key, each in compared.items()}
        told[name] = {
            names.get(key, key): each.mean(units[chosen.numpy()])
            for key, each in parts.items()
            if bool(each.values.isfinite().any())
        }
    return {"pathologies": told}


def balanced_accuracy(right: Tensor, views: Tensor, units: np.ndarray) -> dict[str, Any]:
    """Return the mean over labels of the share of their frames that are labelled right, as JSON.

    Args:
        right: (N,) float64, 1 where the label is the true one, 0 where not, NaN where unknown.
        views: (N,) the true labels.
        units: (N,) what was drawn independently.
    """
    known = right.isfinite()
    hits, labels = right[known].numpy(), views[known].numpy()

    def mean(kept: np.ndarray) -> float:
        count = np.bincount(labels[kept])
        sums = np.bincount(labels[kept], weights=hits[kept])
        return float((sums[count > 0] / count[count > 0]).mean())

    found = interval(set_replicates([mean], units[known.numpy()]), 0.0, 1.0)
    return found.to_json(rule="mean over labels of the share of their frames labelled right")


def confusion_counts(label: Tensor, truth: Tensor, labels: int = len(LABELS)) -> list[list[int]]:
    """Count (N,) labels by truth (row) and label (column); frames of unknown view are left out."""
    known = truth >= 0
    pairs = truth[known] * labels + label[known]
    return torch.bincount(pairs, minlength=labels**2).view(labels, -1).tolist()


class Reliability(NamedTuple):
    """Number of frames, mean confidence and share of right labels by bin of confidence.

    (BINS,) float64 each, 0 where a bin is empty.
    """

    frames: Tensor
    confidence: Tensor
    accuracy: Tensor

    @property
    def error(self) -> float:
        """The expected calibration error: the gap between the two, averaged over frames."""
        gap = (self.confidence - self.accuracy).abs() * self.frames
        return float(gap.sum() / self.frames.sum().clamp_min(1.0))


def fit_temperature(logits: Tensor, views: Tensor) -> float:
    """Return the temperature of least cross-entropy of (N, L) logits over known views, else 1."""
    known = views >= 0
    logits, views = logits[known].double(), views[known]
    if not len(views):
        return 1.0

    def loss(log_temperature: float) -> float:
        scaled = logits / np.exp(log_temperature)
        return float(torch.nn.functional.cross_entropy(scaled, views))

    bounds = (-np.log(LIMIT), np.log(LIMIT))
    found: Any = minimize_scalar(loss, bounds=bounds, method="bounded")
    return float(np.exp(found.x))


def reliability(probabilities: Tensor, views: Tensor) -> Reliability:
    """Compare the confidence of (N, L) probabilities with (N,) views; -1 is left out."""
    known = views >= 0
    confidence, label = probabilities[known].double().max(-1)
    right = (label == views[known]).double()
    # Bins are open below and closed above, as in the paper.
    index = ((confidence * BINS).ceil().long() - 1).clamp(0, BINS - 1)
    weights = (torch.ones_like(right), confidence, right)
    count, sure, hit = (torch.bincount(index, values, BINS) for values in weights)
    return Reliability(count, sure / count.clamp_min(1.0), hit / count.clamp_min(1.0))


def calibrate(grader: Grader, store: FrameStore, split: str = "validation") -> int:
    """Set the grader's temperature by a split, 1 if no view is known; return how many are."""
    grader.check_labels(store.labels, "the dataset")
    rows = store.split_indices(split)
    views = store.views[rows]
    known, grader.temperature = int((views >= 0).sum()), 1.0
    if known:
        grader.temperature = fit_temperature(grader.read(store.take(rows).images).logits, views)
    return known


def calibration_error(probabilities: Tensor, views: Tensor, units: np.ndarray) -> Any:
    """Return the expected calibration error of (N, L) probabilities as JSON, with its interval."""
    known = (views >= 0).numpy()
    probabilities, views = probabilities[known], views[known]

    def error(kept: np.ndarray) -> float:
        return reliability(probabilities[kept], views[kept]).error

    found = interval(set_replicates([error], units[known]), 0.0, 1.0)
    return found.to_json(bins=BINS, rule="mean gap of confidence and accuracy over bins")
