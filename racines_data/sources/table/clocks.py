"""Times in seconds, and the poses that images with a clock of their own find by it.

rows      |----o----o----o---------o----o---|      poses
images    |--^----^----^----^----^----^-----|      each from its two neighbours, or the nearest
                            ×                      too far from a row: refused, not invented
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation as Turn
from scipy.spatial.transform import Slerp

from racines_data.errors import RacinesError
from racines_data.sources.table.mapping import Match, Time
from racines_data.sources.table.rows import column, numbers

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read_times(
    table: pl.DataFrame, time: Time, field: str, path: Path, count: int | None = None
) -> np.ndarray:
    """Return (T,) float64 seconds of the rows; of `count` rows, where only a rate is known.

    Raises:
        RacinesError: no such column, or it holds no times of that unit.
    """
    if time.column is None:
        assert time.rate is not None
        return time.start + np.arange(len(table) if count is None else count) / time.rate
    if time.unit == "iso":
        return _iso(column(table, time.column, f"{field}.column", path), field, path)
    values = numbers(table, [time.column], f"{field}.column", path)
    if values.shape[1] != 1:
        raise RacinesError(f"{path}: {field}.column: {values.shape[1]} numbers a row, not one time")
    return values[:, 0] * SECONDS[time.unit]


def _iso(series: pl.Series, field: str, path: Path) -> np.ndarray:
    try:
        if series.dtype == pl.String:
            series = series.str.to_datetime(time_unit="ns", time_zone="UTC", strict=True)
        return series.dt.timestamp("ns").cast(pl.Float64).fill_null(np.nan).to_numpy() * 1e-9
    except pl.exceptions.PolarsError as error:
        said = " ".join(str(error).split())[:120]
        raise RacinesError(
            f"{path}: {field}.unit: column {series.name!r} holds no ISO 8601 times ({said})"
        ) from error


class Matched(NamedTuple):
    """What the images found."""

    poses: np.ndarray
    """(N, 4, 4), NaN where there is no row near enough."""
    nearest: np.ndarray
    """(N,) the nearest row of each image."""
    gaps: np.ndarray
    """(N,) time to the farthest row used, s."""


def match(times: np.ndarray, poses: np.ndarray, images: np.ndarray, how: Match) -> Matched:
    """Return the poses of images by their times.

    Args:
        times: (T,) seconds of the rows, increasing.
        poses: (T, 4, 4), rigid.
        images: (N,) seconds of the images.
        how: Nearest or interpolated, the farthest row that counts, the clocks' offset.
    """
    wanted = images + how.offset
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before, after = after - 1, np.minimum(after, len(times) - 1)
    left, right = np.abs(wanted - times[before]), np.abs(times[after] - wanted)
    nearest = np.where(left <= right, before, after)
    gaps = np.minimum(left, right)
    made = poses[nearest].copy()
    if how.how == "interpolate" and len(times) > 1:
        inside = (wanted >= times[0]) & (wanted <= times[-1])
        exact = gaps == 0
        gaps = np.where(inside & ~exact, np.maximum(left, right), gaps)
        made[inside] = _between(times, poses, wanted[inside])
    made[gaps > how.max_gap] = np.nan
    return Matched(made, nearest, gaps)


def _between(times: np.ndarray, poses: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return (N, 4, 4): positions linearly, rotations along the shortest arc (slerp)."""
    made = np.tile(np.eye(4), (len(wanted), 1, 1))
    if len(wanted):
        made[:, :3, :3] = Slerp(times, Turn.from_matrix(poses[:, :3, :3]))(wanted).as_matrix()
    for axis in range(3):
        made[:, axis, 3] = np.interp(wanted, times, poses[:, axis, 3])
    return made
