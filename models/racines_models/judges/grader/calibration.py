"""How far a grader's confidence can be believed, and the temperature that mends it.

Temperature scaling and the expected calibration error are after Guo et al., On Calibration of
Modern Neural Networks (2017): one number divides the logits, so no label changes.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from racines_data.store.frames import FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.statistics import jackknife

BINS = 15
"""Bins of equal width in confidence."""
LIMIT = 10.0
"""Largest temperature that is looked for, and the inverse of the smallest."""


class Reliability(NamedTuple):
    """Confidence and accuracy by bin of confidence."""

    frames: Tensor
    """(BINS,) float64, how many."""
    confidence: Tensor
    """(BINS,) float64 mean confidence, 0 where a bin is empty."""
    accuracy: Tensor
    """(BINS,) float64 share of right labels, 0 where a bin is empty."""

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
    count, sure, hit = (
        torch.zeros(BINS, dtype=torch.float64).index_add_(0, index, values)
        for values in (torch.ones_like(right), confidence, right)
    )
    return Reliability(count, sure / count.clamp_min(1.0), hit / count.clamp_min(1.0))


def calibrate(grader: Grader, store: FrameStore, split: str = "validation") -> int:
    """Set the grader's temperature by the frames of a split; return how many had a view.

    A split without known views leaves the temperature at 1.

    Raises:
        RacinesError: the grader was trained for other views.
    """
    grader.check_labels(store.labels, "the dataset")
    rows = store.split_indices(split)
    views = store.views[rows]
    known = int((views >= 0).sum())
    if known:
        grader.temperature = fit_temperature(grader.read(store.take(rows).images).logits, views)
    else:
        grader.temperature = 1.0
    return known


def calibration_error(probabilities: Tensor, views: Tensor, trajectory: np.ndarray) -> Any:
    """Return the expected calibration error of (N, L) probabilities as JSON, with its interval."""
    known = (views >= 0).numpy()
    probabilities, views = probabilities[known], views[known]

    def error(kept: np.ndarray) -> float:
        return reliability(probabilities[kept], views[kept]).error

    estimate = jackknife(error, trajectory[known], minimum=0.0)
    return estimate.to_json(bins=BINS, rule="mean gap of confidence and accuracy over bins")
