"""95 % intervals over episodes, as scores files hold them: value, low, high, n."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import norm, trim_mean

LEVEL = 0.95
_Z = float(norm.ppf(0.5 + LEVEL / 2))


def wilson(hits: np.ndarray) -> dict[str, Any]:
    """Return the rate of (n,) booleans with Wilson's score interval (Wilson, 1927)."""
    n = len(hits)
    if n == 0:
        return {"value": None, "low": None, "high": None, "n": 0}
    rate = float(np.mean(hits))
    centre = (rate + _Z**2 / (2 * n)) / (1 + _Z**2 / n)
    half = _Z / (1 + _Z**2 / n) * np.sqrt(rate * (1 - rate) / n + _Z**2 / (4 * n**2))
    # The interval reaches its end exactly where no or every trial was a hit.
    low = 0.0 if rate == 0.0 else float(centre - half)
    high = 1.0 if rate == 1.0 else float(centre + half)
    return {"value": rate, "low": low, "high": high, "n": n, "settings": {"interval": "Wilson"}}


def mean(values: np.ndarray, unit: str | None = None, resamples: int = 2000) -> dict[str, Any]:
    """Return the mean of (n,) values with a percentile bootstrap interval over episodes."""
    return _bootstrap(values, lambda x: x.mean(-1), unit, resamples)


def interquartile_mean(
    values: np.ndarray, unit: str | None = None, resamples: int = 2000
) -> dict[str, Any]:
    """Return the mean of the middle half (IQM; Agarwal et al., 2021) with a bootstrap interval."""
    return _bootstrap(values, lambda x: trim_mean(x, 0.25, axis=-1), unit, resamples)


def median(values: np.ndarray, unit: str | None = None, resamples: int = 2000) -> dict[str, Any]:
    """Return the median of (n,) values with a percentile bootstrap interval over episodes."""
    return _bootstrap(values, lambda x: np.median(x, -1), unit, resamples)


def _bootstrap(
    values: np.ndarray, statistic: Callable[[np.ndarray], Any], unit: str | None, resamples: int
) -> dict[str, Any]:
    values = np.asarray(values, np.float64)
    n = len(values)
    figure: dict[str, Any] = {"value": None, "low": None, "high": None, "n": n}
    if n:
        figure["value"] = float(statistic(values))
    if n > 1:
        drawn = values[np.random.default_rng(0).integers(0, n, (resamples, n))]
        low, high = np.quantile(statistic(drawn), [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
        figure |= {"low": float(low), "high": float(high)}
    if unit is not None:
        figure["unit"] = unit
    method = f"percentile bootstrap over episodes, {resamples} resamples"
    return figure | {"settings": {"interval": method}}
