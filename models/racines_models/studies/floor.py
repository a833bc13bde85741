"""Truth against truth: FID and KID of two disjoint halves of a split, and how FID falls with n.

No generator can be expected below these figures at the same n. The halves share no trajectory, as
neighbouring frames of one sweep are near-copies.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.store.frames import FrameStore
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, Sample, evenly, spread_sample
from racines_models.scores import metrics
from racines_models.scores.features import Extractor, reference_features

SCHEMA = "racines.score-floor/1"
SLACK = 1.1
"""Frames looked at, as a multiple of twice the largest n: halves by trajectory are not equal."""


@dataclass(frozen=True)
class FloorConfig:
    """Which halves are compared."""

    sizes: tuple[int, ...] = (128, 256, 512, 1024)
    """Frames of each half, n; those that the split cannot fill are left out."""
    splits: int = 10
    """Random halvings of the trajectories; figures are means over them."""
    split: str = "test"
    seed: int = 0


def measure_floor(
    store: FrameStore,
    extractors: Mapping[str, Extractor],
    config: FloorConfig,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare halves of a split.

    Returns:
        `rows`: by extractor, one row a size with n, and `fid` and `kid`, each `value` (mean),
        `low` and `high` (range over the halvings); and what they depend on.
    """
    began = time.perf_counter()
    pool = frames_needed(store, config)
    halvings = halve(pool.trajectory, config)
    largest = min(len(half) for pair in halvings for half in pair)
    sizes = [n for n in sorted(config.sizes) if 2 <= n <= largest]
    if not sizes:
        raise RacinesError(
            f"split {config.split}: its halves have {largest} frames, fewer than the smallest of "
            f"the sizes {config.sizes}: give smaller ones, or another split"
        )
    rows = {}
    for name, extractor in extractors.items():
        key = [store.manifest["digest"], pool.digest]
        features = reference_features(extractor, pool.frames.images, key, cache, progress)
        rows[name] = [_row(features, halvings, n) for n in sizes]
    return {
        "schema": SCHEMA,
        "dataset": dataset_card(store) | {"split": config.split, "sample": pool.digest},
        "halves": f"disjoint by trajectory, {config.splits} halvings; low and high are their range",
        "trajectories": len(np.unique(pool.trajectory)),
        "seed": config.seed,
        "rows": rows,
        "extractors": {name: each.settings for name, each in extractors.items()},
        "code": code_version(),
        "environment": environment(),
        "seconds": round(time.perf_counter() - began, 3),
    }


def frames_needed(store: FrameStore, config: FloorConfig) -> Sample:
    """Return the frames that the halves are made of, spread over the split's trajectories."""
    rows = store.split_indices(config.split)
    pool = spread_sample(store, rows, round(2 * SLACK * max(config.sizes)))
    if len(np.unique(pool.trajectory)) < 2:
        raise RacinesError(f"split {config.split} has no two trajectories: it cannot be halved")
    return pool


def halve(trajectory: np.ndarray, config: FloorConfig) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return, for each halving, the places of the frames of either half of the trajectories."""
    names, counts = np.unique(trajectory, return_counts=True)
    pairs = []
    for number in range(config.splits):
        order = np.random.default_rng([config.seed, number]).permutation(len(names))
        reached = np.cumsum(counts[order])
        cut = int(np.abs(reached[:-1] - reached[-1] / 2).argmin()) + 1
        first = np.isin(trajectory, names[order[:cut]])
        pairs.append((np.flatnonzero(first), np.flatnonzero(~first)))
    return pairs


def _row(features: Tensor, halvings: list[tuple[np.ndarray, np.ndarray]], n: int) -> dict[str, Any]:
    fid, kid = [], []
    for pair in halvings:
        a, b = (features[torch.from_numpy(half)[evenly(len(half), n)]] for half in pair)
        fid.append(metrics.fid(a, b))
        kid.append(metrics.kid(a, b))
    return {"n": n, "fid": metrics.over_splits(fid), "kid": metrics.over_splits(kid)}


def draw_floor(content: dict[str, Any]) -> bytes:
    """Return a PNG of FID and KID against n, one row an extractor, with the range as a band."""
    from matplotlib.figure import Figure

    from racines_data.plotting import OURS, card_style, encode

    with card_style():
        extractors = content["rows"]
        figure = Figure(figsize=(7.2, 2.5 * len(extractors)), layout="constrained")
        grid = figure.subplots(len(extractors), 2, squeeze=False)
        for row, (name, rows) in zip(grid, extractors.items(), strict=True):
            n = [each["n"] for each in rows]
            for axes, key in zip(row, ("fid", "kid"), strict=True):
                ends = ("value", "low", "high")
                value, low, high = ([each[key][end] for each in rows] for end in ends)
                span = {"alpha": 0.25, "linewidth": 0, "label": "range over halvings"}
                axes.fill_between(n, low, high, color=OURS, **span)
                axes.plot(n, value, "o-", color=OURS, markersize=3.5, label="mean")
                axes.set_xscale("log", base=2)
                axes.set_xticks(n, [str(each) for each in n])
                axes.minorticks_off()
                axes.set(title=f"{key.upper()}, {name} features", ylim=(min(0.0, *low), None))
        for axes in grid[-1]:
            axes.set_xlabel("frames of each half, n")
        grid[0, 0].legend()
        return encode(figure)
