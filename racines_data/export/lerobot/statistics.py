"""Statistics of features as LeRobot keeps them, by episode and for the whole dataset."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from racines_data.store.sweeps import Sweep

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
STRIDE = 10
"""One frame in so many gives the statistics of images."""


def image_histogram(sweep: Sweep, start: int) -> np.ndarray:
    """Return (257,) int64: counts of the 256 gray levels in some frames, and of these frames.

    Args:
        sweep: The trajectory.
        start: Row of its first frame: the frames chosen are the multiples of STRIDE, one at least.
    """
    pngs = sweep.pngs()
    chosen = pngs[-start % STRIDE :: STRIDE] or pngs[:1]
    counts = np.zeros(257, np.int64)
    for png in chosen:
        pixels = np.asarray(Image.open(io.BytesIO(png)))
        counts[:256] += np.bincount(pixels.ravel(), minlength=256)
    counts[256] = len(chosen)
    return counts


@dataclass
class Statistics:
    """Collects numbers, then gives minimum, maximum, mean, std, count and quantiles of each.

    Unknown numbers (NaN) are left out; a column that has no number has zeros, as JSON has no NaN.
    """

    columns: dict[str, list[np.ndarray]] = field(default_factory=dict)
    histogram: np.ndarray = field(default_factory=lambda: np.zeros(257, np.int64))

    def add(self, columns: Mapping[str, np.ndarray], histogram: np.ndarray) -> None:
        """Add rows: (T,) or (T, D) of each feature, and the images' histogram."""
        for name, values in columns.items():
            self.columns.setdefault(name, []).append(values)
        self.histogram += histogram

    def merge(self, other: "Statistics") -> None:
        """Add what another one has collected."""
        for name, parts in other.columns.items():
            self.columns.setdefault(name, []).extend(parts)
        self.histogram += other.histogram

    def result(self, image: str) -> dict[str, dict[str, Any]]:
        """Return the statistics of each feature; those of `image` have the shape (1, 1, 1)."""
        found = {image: _of_histogram(self.histogram)}
        for name, parts in self.columns.items():
            found[name] = _of_values(np.concatenate(parts))
        return found


def _of_values(values: np.ndarray) -> dict[str, list[float]]:
    table = values.reshape(len(values), -1).astype(np.float64)
    table[:, np.isnan(table).all(0)] = 0.0
    made = {
        "min": np.nanmin(table, 0),
        "max": np.nanmax(table, 0),
        "mean": np.nanmean(table, 0),
        "std": np.nanstd(table, 0),
    }
    quantiles = np.nanquantile(table, [*QUANTILES.values()], axis=0)
    made |= dict(zip(QUANTILES, quantiles, strict=True))
    return {**{key: value.tolist() for key, value in made.items()}, "count": [len(values)]}


def _of_histogram(histogram: np.ndarray) -> dict[str, Any]:
    """Return the statistics of gray levels scaled to 0-1, as LeRobot hands images out."""
    counts, levels = histogram[:256], np.arange(256) / 255
    total = counts.sum()
    mean = float((counts * levels).sum() / total)
    seen, running = levels[counts > 0], np.cumsum(counts) / total
    made = {
        "min": float(seen[0]),
        "max": float(seen[-1]),
        "mean": mean,
        "std": float(np.sqrt((counts * (levels - mean) ** 2).sum() / total)),
    }
    made |= {key: float(levels[np.searchsorted(running, q)]) for key, q in QUANTILES.items()}
    return {**{key: [[[value]]] for key, value in made.items()}, "count": [int(histogram[256])]}
