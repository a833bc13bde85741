"""Intervals that respect trajectories: frames of one sweep are near-copies, never independent.

A mean gets a percentile bootstrap that resamples whole trajectories. A distance between two sets
(FID, KID) gets a delete-a-block jackknife: resampling with replacement puts copies of a frame into
a set, which inflates the distance itself, and leaving out does not.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from racines_models.statistics.intervals import LEVEL, wilson_ends


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; the ends are None where one cluster allows none."""

    value: float
    low: float | None
    high: float | None
    n: int
    """Samples the value is made of."""
    clusters: int
    """Trajectories they come from."""
    method: str

    def to_json(self, unit: str | None = None, **settings: Any) -> dict[str, Any]:
        """Return the estimate as it stands in a scores file."""
        described = {key: getattr(self, key) for key in ("value", "low", "high", "n")}
        if unit is not None:
            described["unit"] = unit
        interval = {"interval": self.method, "trajectories": self.clusters}
        return described | {"settings": settings | interval}


def bootstrap_mean(
    values: np.ndarray, clusters: np.ndarray, seed: int = 0, resamples: int = 1000
) -> Estimate:
    """Estimate the mean of (N,) values, resampling their (N,) clusters with replacement.

    NaN values are absent measurements and are left out; a `ValueError` says that none is present.
    """
    present = np.isfinite(values)
    values = np.asarray(values, np.float64)[present]
    if not len(values):
        raise ValueError("no values to estimate from")
    unique, cluster = np.unique(clusters[present], return_inverse=True)
    count, low, high = len(unique), None, None
    if count > 1:
        generator = np.random.default_rng(seed)
        draws = generator.multinomial(count, np.full(count, 1 / count), size=resamples)
        means = (draws @ np.bincount(cluster, weights=values)) / (draws @ np.bincount(cluster))
        low, high = _interval(means)
    method = f"percentile bootstrap by trajectory, {resamples} resamples"
    return Estimate(float(values.mean()), low, high, len(values), count, method)


def jackknife(
    statistic: Callable[[np.ndarray], float],
    clusters: np.ndarray,
    blocks: int = 20,
    minimum: float = -np.inf,
) -> Estimate:
    """Estimate a statistic of N samples, deleting blocks of (N,) clusters in turn.

    `statistic` takes a (N,) boolean mask of the samples to keep. The interval is the value ± t
    times the standard error, t with blocks - 1 degrees of freedom, cut at `minimum`.
    """
    return jackknife_all(lambda keep: {"": statistic(keep)}, clusters, blocks, minimum)[""]


def jackknife_all(
    statistics: Callable[[np.ndarray], Mapping[str, float]],
    clusters: np.ndarray,
    blocks: int = 20,
    minimum: float = -np.inf,
) -> dict[str, Estimate]:
    """Estimate several statistics that are computed together; see `jackknife`."""
    unique, cluster = np.unique(clusters, return_inverse=True)
    blocks = min(blocks, len(unique))
    values = statistics(np.ones(len(clusters), bool))
    parts = [statistics(cluster % blocks != block) for block in range(blocks if blocks > 1 else 0)]
    method = f"jackknife by trajectory, {blocks} blocks, Student t"
    estimates = {}
    for name, value in values.items():
        low = high = None
        if parts:
            of_blocks = np.array([each[name] for each in parts])
            error = np.sqrt((blocks - 1) / blocks * np.square(of_blocks - of_blocks.mean()).sum())
            half = float(stats.t.ppf(0.5 + LEVEL / 2, blocks - 1) * error)
            low, high = max(value - half, minimum), value + half
        estimates[name] = Estimate(float(value), low, high, len(clusters), len(unique), method)
    return estimates


def _interval(resampled: np.ndarray) -> list[float]:
    return np.quantile(resampled, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]).tolist()


def wilson(hits: np.ndarray) -> dict[str, Any]:
    """Return the rate of (n,) booleans with Wilson's score interval (Wilson, 1927)."""
    n = len(hits)
    if n == 0:
        return {"value": None, "low": None, "high": None, "n": 0}
    rate = float(np.mean(hits))
    low, high = wilson_ends(rate, n)
    return {"value": rate, "low": low, "high": high, "n": n, "settings": {"interval": "Wilson"}}


def median(values: np.ndarray, unit: str | None = None, resamples: int = 2000) -> dict[str, Any]:
    """Return the median of (n,) times with a percentile bootstrap interval over them."""
    values = np.asarray(values, np.float64)
    n = len(values)
    figure: dict[str, Any] = {"value": None, "low": None, "high": None, "n": n}
    if n:
        figure["value"] = float(np.median(values))
    if n > 1:
        drawn = values[np.random.default_rng(0).integers(0, n, (resamples, n))]
        figure["low"], figure["high"] = _interval(np.median(drawn, -1))
    if unit is not None:
        figure["unit"] = unit
    return figure | {"settings": {"interval": f"percentile bootstrap, {resamples} resamples"}}
