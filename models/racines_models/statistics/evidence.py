"""What the scores of a method rest on: the figures of each item, kept beside the scores file.

A metric that is the mean or the median of its items keeps each item of each training and draw; one
of a whole set, such as FID, keeps its replicates: the value of each training, whole and with each
block of units left out. Either way the metric's value and interval follow from the file alone, and
so do those of the difference of two methods and of a score made of several metrics.

The file is one Parquet table in long form:

    metric     string    name, as in the scores file
    statistic  string    `mean`, `rate`, `median` or `set`
    training   int16     which training of the method, from 0
    draw       int16     which set of images of one training, from 0; null for `set`
    item       int32     a frame's row in the dataset or an episode's place; for `set` how many
    unit       int32     what was drawn independently (a trajectory, a patient, an episode); for
                         `set` how many
    block      int16     for `set` the block of units that is left out, -1 for none; else null
    value      float64   null where there is no measurement
    minimum    float64   the least that the metric can be, at which its interval is cut; null: none
    maximum    float64   the most, likewise

Items stand in one order for all trainings and draws of a metric. The same figures are the same
bytes.
"""

import io
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.files import locked, sha256_file, write_atomic, write_json
from racines_models.provenance import check_replaces, sha256_bytes
from racines_models.statistics.intervals import (
    Interval,
    Replicates,
    interval,
    mean_interval,
    mean_replicates,
    median_interval,
    median_replicates,
    rate_interval,
)

STATISTICS = ("mean", "rate", "median", "set")
SCHEMA = {
    "metric": pl.String,
    "statistic": pl.String,
    "training": pl.Int16,
    "draw": pl.Int16,
    "item": pl.Int32,
    "unit": pl.Int32,
    "block": pl.Int16,
    "value": pl.Float64,
    "minimum": pl.Float64,
    "maximum": pl.Float64,
}
ENDS = ("minimum", "maximum")
MOST_BYTES = 4 << 20
"""Largest file that is read."""


@dataclass(frozen=True)
class Figures:
    """The figures of one metric: of R trainings, D draws and N items, or replicates of a set."""

    statistic: str
    values: np.ndarray | None = None
    """(R, D, N), NaN where there is no measurement; None for a `set`."""
    items: np.ndarray | None = None
    """(N,)"""
    units: np.ndarray | None = None
    """(N,)"""
    whole: Replicates | None = None
    """Of a `set`."""
    minimum: float = -np.inf
    """The least that the metric can be."""
    maximum: float = np.inf
    """The most."""

    def replicates(self) -> Replicates:
        """Return the metric's replicates; items of several draws are one item's."""
        if self.whole is not None:
            return self.whole
        values, units = self._flat()
        if self.statistic != "median":
            return mean_replicates(values, units)
        found = median_replicates(values, units)
        return replace(found, n=found.n * len(self._units()) // len(units))

    @property
    def trainings(self) -> int:
        """How many trainings there are."""
        kept = self.values if self.whole is None else self.whole.whole
        assert kept is not None
        return len(kept)

    def interval(self, minimum: float = -np.inf, maximum: float = np.inf) -> Interval:
        """Return the metric's value and interval, cut at the least and the most it can be."""
        minimum, maximum = max(minimum, self.minimum), min(maximum, self.maximum)
        if self.whole is not None:
            return interval(self.whole, minimum, maximum, "set")
        values, units = self._flat()
        if self.statistic == "rate":
            return rate_interval(values, units)
        if self.statistic == "median":
            found = median_interval(values, units, minimum, maximum)
            return replace(found, n=found.n * len(self._units()) // len(units))
        return mean_interval(values, units, minimum, maximum)

    def _flat(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (R, M) values and (M,) units: draws averaged, or side by side for a median."""
        assert self.values is not None
        if self.statistic == "median":
            trainings, draws, _ = self.values.shape
            return self.values.reshape(trainings, -1), np.tile(self._units(), draws)
        return self.values.mean(1), self._units()

    def _units(self) -> np.ndarray:
        assert self.units is not None
        return self.units


def figure(
    statistic: str,
    values: Any,
    unit: str | None = None,
    minimum: float = -np.inf,
    maximum: float = np.inf,
    units: Any = None,
) -> dict[str, Any]:
    """Return a `mean`, `rate` or `median` of (N,) values, each of its own unit if none are given.

    As it stands in a scores file; NaN is an absent measurement, and of none there is no value.
    """
    values = np.asarray(values, np.float64)
    if not np.isfinite(values).any():
        return {"value": None, "low": None, "high": None, "n": 0} | ({"unit": unit} if unit else {})
    places = np.arange(len(values))
    figures = Figures(statistic, values[None, None], places, places if units is None else units)
    return figures.interval(minimum, maximum).to_json(unit)


@dataclass
class Evidence:
    """The figures of every metric of one method, by name."""

    figures: dict[str, Figures] = field(default_factory=dict)

    def add(
        self,
        metric: str,
        statistic: str,
        values: Any,
        items: Any,
        units: Any,
        minimum: float = -np.inf,
        maximum: float = np.inf,
    ) -> Figures:
        """Keep the figures of items, (R, D, N) or (D, N) or (N,) values; return them.

        The interval is cut at `minimum` and `maximum`, the least and the most the metric can be; a
        rate's at 0 and 1.

        Raises:
            ValueError: shapes that do not fit, a statistic of no name, a metric that is there.
        """
        values = np.asarray(values, np.float64)
        values = values.reshape((1,) * (3 - values.ndim) + values.shape)
        items, units = _small(metric, items), _small(metric, units)
        if values.ndim != 3 or not (items.shape == units.shape == values.shape[2:]):
            raise ValueError(f"{metric}: {values.shape} values, {items.shape} items")
        if statistic not in STATISTICS[:3]:
            raise ValueError(f"{metric}: statistic {statistic!r}, not of {STATISTICS[:3]}")
        ends = (0.0, 1.0) if statistic == "rate" else (minimum, maximum)
        return self._keep(metric, Figures(statistic, values, items, units, None, *ends))

    def add_set(
        self,
        metric: str,
        replicates: Replicates,
        minimum: float = -np.inf,
        maximum: float = np.inf,
    ) -> Figures:
        """Keep the replicates of a metric of whole sets; return its figures."""
        figures = Figures("set", whole=replicates, minimum=minimum, maximum=maximum)
        return self._keep(metric, figures)

    def _keep(self, metric: str, figures: Figures) -> Figures:
        if metric in self.figures:
            raise ValueError(f"{metric}: its figures are there already")
        self.figures[metric] = figures
        return figures

    def to_bytes(self) -> bytes:
        """Return the file's content; the same figures give the same bytes."""
        tables = [_table(name, each) for name, each in self.figures.items()]
        table = pl.concat(tables) if tables else pl.DataFrame(schema=SCHEMA)
        out = io.BytesIO()
        table.write_parquet(out, compression="zstd", compression_level=9, statistics=False)
        return out.getvalue()

    def write(self, path: Path) -> dict[str, Any]:
        """Write the file; return its name and sha256 as they stand in the scores."""
        write_atomic(path, self.to_bytes())
        return {"file": path.name, "sha256": sha256_file(path)}

    @classmethod
    def read(cls, path: Path) -> "Evidence":
        """Read a file that `write` left.

        Raises:
            RacinesError: no file, one too large, or one that is no such table.
        """
        try:
            if path.stat().st_size > MOST_BYTES:
                raise RacinesError(f"{path}: larger than {MOST_BYTES >> 20} MiB; score it again")
            table = pl.read_parquet(path)
        except OSError as error:
            raise RacinesError(f"{path}: no evidence: {error}; score it again") from error
        except pl.exceptions.PolarsError as error:
            raise RacinesError(f"{path}: not readable as Parquet: {error}") from error
        if dict(table.schema) != SCHEMA:
            raise RacinesError(f"{path}: columns {dict(table.schema)}; expected {SCHEMA}")
        evidence = cls()
        try:
            for part in _parts(table):
                evidence._keep(*_figures(part))
            return evidence
        except (ValueError, TypeError) as error:
            raise RacinesError(f"{path}: damaged: {error}; score it again") from error


def write_scores(
    path: Path, scores: dict[str, Any], evidence: Evidence, force: bool = False
) -> dict[str, Any]:
    """Write scores, and what they rest on beside them in `<name>.parquet`; return the scores.

    They name that file by its hash. It is written first: scores never name what is not there.

    Raises:
        RacinesError: without `force`, another result is there, or a file that is no part of it.
    """
    beside, content = path.with_suffix(".parquet"), evidence.to_bytes()
    told = {"file": beside.name, "sha256": sha256_bytes(content)}
    scores = scores | {"evidence": told}
    with locked(path.parent):
        check_replaces(path, scores, force)
        if not force and beside.exists() and sha256_file(beside) != told["sha256"]:
            reason = f"is there, and is not what {path.name} is to rest on"
            raise RacinesError(f"{beside}: {reason}: --force to replace it, or write elsewhere")
        write_atomic(beside, content)
        write_json(path, scores)
    return scores


def _small(metric: str, numbers: Any) -> np.ndarray:
    """Return whole numbers in 32 bits, as the file keeps them."""
    whole, limits = np.asarray(numbers), np.iinfo(np.int32)
    if whole.size and not (limits.min <= whole.min() and whole.max() <= limits.max):
        raise ValueError(f"{metric}: items and units are numbers of 32 bits")
    return whole.astype(np.int32)


def _table(metric: str, figures: Figures) -> pl.DataFrame:
    """Return the rows of one metric."""
    named: dict[str, Any] = {"metric": metric, "statistic": figures.statistic}
    columns = named | _columns(figures)
    columns["value"] = pl.Series(columns["value"]).fill_nan(None)
    table = pl.select([pl.lit(each).alias(key) for key, each in columns.items()])
    return table.select(*SCHEMA).cast(SCHEMA)  # type: ignore[arg-type]


def _columns(figures: Figures) -> dict[str, Any]:
    """Return the columns of one metric's rows, each an array or what all rows hold.

    A value is NaN where there is no measurement.
    """
    columns: dict[str, Any]
    if (of_set := figures.whole) is not None:
        values = np.column_stack([of_set.whole, of_set.without])
        trainings, blocks = values.shape
        columns = {"draw": None, "item": of_set.n, "unit": of_set.units}
        columns |= {"block": np.tile(np.arange(blocks) - 1, trainings)}
        training = np.repeat(np.arange(trainings), blocks)
    else:
        assert figures.values is not None and figures.items is not None
        values = figures.values
        trainings, draws, items = values.shape
        training, draw = np.divmod(np.repeat(np.arange(trainings * draws), items), draws)
        columns = {"draw": draw, "block": None}
        columns |= {"item": np.tile(figures.items, trainings * draws)}
        columns |= {"unit": np.tile(figures._units(), trainings * draws)}
    columns |= {"training": training, "value": values.ravel()}
    for key in ENDS:
        end = getattr(figures, key)
        columns[key] = float(end) if np.isfinite(end) else None
    return columns


class _Column(NamedTuple):
    """Rows of a column: their values, and where there is none."""

    values: np.ndarray
    absent: np.ndarray

    def rows(self, start: int, stop: int) -> "_Column":
        return _Column(self.values[start:stop], self.absent[start:stop])

    def holds(self, expected: Any) -> bool:
        """Return whether the rows are as expected: absent for None, and for NaN."""
        if expected is None:
            return bool(self.absent.all())
        wanted = np.broadcast_to(expected, self.values.shape)
        absent = np.isnan(wanted) if wanted.dtype.kind == "f" else np.zeros(wanted.shape, bool)
        same = (self.values == wanted) | absent
        return bool(same.all()) and np.array_equal(self.absent, absent)


def _parts(table: pl.DataFrame) -> Iterator[dict[str, _Column]]:
    """Give the rows of each metric by column; of arrays, since tables are slow in small parts."""
    columns = {}
    for key, each in zip(SCHEMA, table.to_arrow().combine_chunks().columns, strict=True):
        filled = each.fill_null("" if SCHEMA[key] == pl.String else 0)
        arrays = (of.to_numpy(zero_copy_only=False) for of in (filled, each.is_null()))
        columns[key] = _Column(*arrays)
    names = columns["metric"].values
    ends = [*(np.flatnonzero(names[1:] != names[:-1]) + 1), len(names)] if len(names) else []
    for start, stop in itertools.pairwise([0, *ends]):
        yield {key: each.rows(start, stop) for key, each in columns.items()}


def _figures(part: dict[str, _Column]) -> tuple[str, Figures]:
    """Return the name and the figures of one metric's rows.

    Raises:
        ValueError: rows that are missing, doubled or out of order.
    """
    metric, statistic = (str(part[key].values[0]) for key in ("metric", "statistic"))
    if statistic not in STATISTICS:
        raise ValueError(f"{metric}: statistic {statistic!r}, not one of {STATISTICS}")
    trainings = 1 + int(part["training"].values.max())
    shown = [key for key in ENDS if not part[key].absent[0]]
    ends: dict[str, Any] = {key: float(part[key].values[0]) for key in shown}
    values = np.where(part["value"].absent, np.nan, part["value"].values)
    if statistic == "set":
        values = values.reshape(trainings, -1)
        units, n = (int(part[key].values[0]) for key in ("unit", "item"))
        figures = Figures(
            statistic, whole=Replicates(values[:, 0], values[:, 1:], units, n), **ends
        )
    else:
        draws = 1 + int(part["draw"].values.max())
        values = values.reshape(trainings, draws, -1)
        items, units = (part[key].values[: values.shape[2]] for key in ("item", "unit"))
        figures = Figures(statistic, values, items, units, **ends)
    expected = {"metric": metric, "statistic": statistic} | _columns(figures)
    if not all(part[key].holds(each) for key, each in expected.items()):
        raise ValueError(f"{metric}: rows are missing, doubled or out of order")
    return metric, figures
