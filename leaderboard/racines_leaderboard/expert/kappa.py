"""Agreement beyond chance: Cohen's kappa, plain and weighted, and Fleiss' kappa of several raters.

Cohen, A coefficient of agreement for nominal scales, 1960; Weighted kappa, 1968. Intervals resample
whole trajectories, since frames of one sweep are near-copies. Where trajectories are few, many a
resample lacks a view, which moves kappa itself; there they are left out in turn instead.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torchmetrics.functional.nominal import fleiss_kappa

from racines_models.statistics import LEVEL, jackknife

MANY = 20
"""Fewest trajectories that are resampled; of fewer each is left out in turn."""
Statistic = Callable[[np.ndarray], np.ndarray]
"""Takes (B, C) int64 weights of C trajectories and returns (B,) values."""


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
    counts: np.ndarray, cost: np.ndarray, rule: str, resamples: int = 1000, seed: int = 0
) -> dict[str, Any]:
    """Return the mean of R raters' kappas with an interval by trajectory.

    `counts` are (R, C, K, K), by rater and trajectory; `rule` says what it is, for its settings.
    """
    n = int(counts.sum((1, 2, 3)).max(initial=0))
    seen = counts[:, counts.sum((0, 2, 3)) > 0]

    def statistic(weights: np.ndarray) -> np.ndarray:
        return kappa(np.einsum("bc,rckl->brkl", weights, seen, optimize=True), cost).mean(1)

    value, settings = float(kappa(seen.sum(1), cost).mean()), {"rule": rule}
    settings |= {"trajectories": seen.shape[1]}
    return _metric(value, n, settings, statistic, seen.shape[1], resamples, seed)


def fleiss_metric(
    views: np.ndarray, groups: np.ndarray, size: int, resamples: int = 1000, seed: int = 0
) -> dict[str, Any]:
    """Return Fleiss' kappa of (R, n) views over the images that all R raters answered."""
    complete = (views >= 0).all(0)
    votes = torch.from_numpy((views[:, complete, None] == np.arange(size)).sum(0))
    unique, cluster = np.unique(groups[complete], return_inverse=True)

    def statistic(weights: np.ndarray) -> np.ndarray:
        rows = [torch.from_numpy(np.repeat(np.arange(len(votes)), w[cluster])) for w in weights]
        return np.array([float(fleiss_kappa(votes[row], mode="counts")) for row in rows])

    value = float(statistic(np.ones((1, len(unique)), np.int64))[0]) if len(votes) else np.nan
    settings = {"rule": "Fleiss' kappa of the views", "library": "torchmetrics"}
    return _metric(value, len(votes), settings, statistic, len(unique), resamples, seed)


def _metric(
    value: float,
    n: int,
    settings: dict[str, Any],
    statistic: Statistic,
    clusters: int,
    resamples: int,
    seed: int,
) -> dict[str, Any]:
    """Return a value, None if it is not finite, with its interval and how that was made."""
    known = bool(np.isfinite(value))
    low, high, method = _interval(statistic, clusters if known else 0, resamples, seed)
    metric = {"value": value if known else None, "low": low, "high": high, "n": n}
    return metric | {"settings": settings | {"interval": method}}


def _interval(
    statistic: Statistic, clusters: int, resamples: int, seed: int
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
    drawn = statistic(np.random.default_rng(seed).multinomial(clusters, share, size=resamples))
    low, high = np.quantile(drawn[np.isfinite(drawn)], [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return float(low), float(high), f"percentile bootstrap by trajectory, {resamples} resamples"
