"""Rank correlations of many pairs at once."""

import numpy as np
from scipy.stats import rankdata


def spearman(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return Spearman's ρ of (…, A) and (…, A) scores, ties at their mean rank; NaN if one is flat.

    Spearman, The Proof and Measurement of Association between Two Things, 1904.
    """
    ranks = [rankdata(values, axis=-1) for values in (x, y)]
    return _cosine(*(each - each.mean(-1, keepdims=True) for each in ranks), axes=-1)


def kendall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return Kendall's τ-b of (…, A) and (…, A) scores; NaN if one is flat.

    Kendall, The Treatment of Ties in Ranking Problems, 1945.
    """
    orders = [np.sign(values[..., :, None] - values[..., None, :]) for values in (x, y)]
    return _cosine(*orders, axes=(-2, -1))


def _cosine(a: np.ndarray, b: np.ndarray, axes: int | tuple[int, int]) -> np.ndarray:
    scale = np.sqrt((a * a).sum(axes) * (b * b).sum(axes))
    return np.where(scale > 0, (a * b).sum(axes) / np.where(scale > 0, scale, 1.0), np.nan)
