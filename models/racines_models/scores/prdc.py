"""Precision, recall, density and coverage of a set of images, by nearest neighbours of features.

Precision and recall: Kynkäänniemi et al., Improved Precision and Recall Metric for Assessing
Generative Models, 2019. Density and coverage: Naeem et al., Reliable Fidelity and Diversity Metrics
for Generative Models, 2020.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError

NEIGHBOURS = 5
"""k: a ball around a sample reaches its k-th nearest neighbour in its own set."""
NAMES = ("precision", "recall", "density", "coverage")
ROWS = 512
"""Rows of a distance matrix made at a time."""

SETTINGS: dict[str, Any] = {"k": NEIGHBOURS, "distance": "Euclidean"}


class Neighbourhoods:
    """The distances within and between a true and a drawn set, so that subsets are cheap."""

    def __init__(self, truth: Tensor, drawn: Tensor, k: int = NEIGHBOURS):
        if len(truth) != len(drawn) or len(truth) <= k:
            raise RacinesError(
                f"PRDC with k = {k} needs two sets of one size > {k}, got {len(truth)} and "
                f"{len(drawn)}; raise scores.samples"
            )
        self._k = k
        self._matrices = _within(truth), _within(drawn), distances(truth, drawn)

    def figures(self, keep: np.ndarray | None = None) -> dict[str, float]:
        """Return the four figures of all samples, or of those that a (N,) mask keeps."""
        truth, drawn, between = self._matrices
        if keep is not None and not keep.all():
            rows = torch.from_numpy(np.flatnonzero(keep))
            truth, drawn, between = (each[rows][:, rows] for each in self._matrices)
        k = min(self._k, len(truth) - 1)
        true_radius, drawn_radius = (each.kthvalue(k, 1).values for each in (truth, drawn))
        in_true_ball = between <= true_radius.unsqueeze(1)
        return {
            "precision": float(in_true_ball.any(0).double().mean()),
            "recall": float((between <= drawn_radius).any(1).double().mean()),
            "density": float(in_true_ball.double().sum(0).mean() / k),
            "coverage": float((between.amin(1) <= true_radius).double().mean()),
        }


def distances(a: Tensor, b: Tensor) -> Tensor:
    """Return the (N, M) float32 distances between (N, D) and (M, D) features, N in batches."""
    b = b.double()
    return torch.cat([torch.cdist(rows.double(), b).float() for rows in a.split(ROWS)])


def _within(features: Tensor) -> Tensor:
    # A sample is no neighbour of its own; copies of it are.
    return distances(features, features).fill_diagonal_(torch.inf)
