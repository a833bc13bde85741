"""Do two backends rank agents alike? Rank correlations with intervals over starts."""

from typing import Any

import numpy as np
from scipy.stats import rankdata

LEVEL = 0.95


def spearman(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return Spearman's ρ of (…, A) and (…, A) scores, ties at their mean rank; NaN if one is flat.

    Spearman, The Proof and Measurement of Association between Two Things, 1904.
    """
    a, b = (rankdata(values, axis=-1) for values in (x, y))
    a, b = (ranks - ranks.mean(-1, keepdims=True) for ranks in (a, b))
    return _ratio((a * b).sum(-1), (a * a).sum(-1), (b * b).sum(-1))


def kendall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return Kendall's τ-b of (…, A) and (…, A) scores; NaN if one is flat.

    Kendall, The Treatment of Ties in Ranking Problems, 1945.
    """
    a, b = (np.sign(values[..., :, None] - values[..., None, :]) for values in (x, y))
    axes = (-2, -1)
    return _ratio((a * b).sum(axes), (a * a).sum(axes), (b * b).sum(axes))


def _ratio(product: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    scale = np.sqrt(first * second)
    return np.where(scale > 0, product / np.where(scale > 0, scale, 1.0), np.nan)


def correlate(x: np.ndarray, y: np.ndarray, resamples: int) -> dict[str, dict[str, Any]]:
    """Return both correlations of A agents' means over n starts, between two backends.

    The interval is a percentile bootstrap over starts; one draw of starts serves all agents and
    both backends, since they share them. Draws in which a backend tells no agents apart have no
    correlation; they are left out and counted.

    Args:
        x: (A, n) a score an agent and start, in one backend.
        y: (A, n) in the other.
        resamples: Of the bootstrap.
    """
    starts = x.shape[1]
    rows = np.random.default_rng(0).integers(0, starts, (resamples, starts))
    # Counting how often a start is drawn is one product, and no (A, resamples, n) array.
    weights = np.stack([np.bincount(row, minlength=starts) for row in rows]) / starts
    drawn = [np.round(weights @ values.T, 12) for values in (x, y)]
    whole = [np.round(values.mean(1), 12) for values in (x, y)]
    return {
        name: _figure(float(rule(*whole)), rule(*drawn), len(x))
        for name, rule in (("spearman", spearman), ("kendall", kendall))
    }


def _figure(value: float, drawn: np.ndarray, agents: int) -> dict[str, Any]:
    defined = drawn[np.isfinite(drawn)]
    figure: dict[str, Any] = {"value": None, "low": None, "high": None, "n": agents}
    if np.isfinite(value):
        low, high = np.quantile(defined, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
        figure |= {"value": value, "low": float(low), "high": float(high)}
    settings = {
        "interval": f"percentile bootstrap over starts, {len(drawn)} resamples",
        "undefined": len(drawn) - len(defined),
    }
    return figure | {"unit": "agents compared", "settings": settings}
