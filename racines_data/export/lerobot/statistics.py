"""Statistics of features as LeRobot's loaders ask for them."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image as Picture

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
STRIDE = 10
"""One frame in so many gives the statistics of images."""


def histogram(pngs: Sequence[bytes], start: int) -> np.ndarray:
    """Return (257,) int64: counts of the 256 gray levels in some images, and of these images.

    Chosen are those whose rows, the first of which is `start`, are multiples of STRIDE, or one.
    """
    chosen = pngs[-start % STRIDE :: STRIDE] or pngs[:1]
    counts = np.zeros(257, np.int64)
    for png in chosen:
        pixels = np.asarray(Picture.open(io.BytesIO(png)))
        counts[:256] += np.bincount(pixels.ravel(), minlength=256)
    counts[256] = len(chosen)
    return counts


def statistics(parts: Sequence[np.ndarray]) -> dict[str, list[float]]:
    """Return minimum, maximum, mean, std, quantiles and count of (T,) or (T, D) parts of a feature.

    Unknown numbers (NaN) are left out; a column that has no number has zeros, as JSON has no NaN.
    """
    table = np.concatenate(parts)
    table = table.reshape(len(table), -1).astype(np.float64)
    table[:, np.isnan(table).all(0)] = 0.0
    made = {
        "min": np.nanmin(table, 0),
        "max": np.nanmax(table, 0),
        "mean": np.nanmean(table, 0),
        "std": np.nanstd(table, 0),
        **dict(zip(QUANTILES, np.nanquantile(table, [*QUANTILES.values()], axis=0), strict=True)),
    }
    return {**{key: value.tolist() for key, value in made.items()}, "count": [len(table)]}


def image_statistics(histograms: Sequence[np.ndarray], channels: int) -> dict[str, Any]:
    """Return the statistics of gray levels scaled to 0-1, as LeRobot hands images out."""
    histogram = np.sum(histograms, axis=0)
    counts, levels = histogram[:256], np.arange(256) / 255
    total = counts.sum()
    mean = float((counts * levels).sum() / total)
    seen, running = levels[counts > 0], np.cumsum(counts) / total
    made = {
        "min": float(seen[0]),
        "max": float(seen[-1]),
        "mean": mean,
        "std": float(np.sqrt((counts * (levels - mean) ** 2).sum() / total)),
        **{key: float(levels[np.searchsorted(running, q)]) for key, q in QUANTILES.items()},
    }
    alike = {key: [[[value]]] * channels for key, value in made.items()}
    return {**alike, "count": [int(histogram[256])]}
