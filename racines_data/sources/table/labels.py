"""Views, grades, sessions and forces of the rows, where a table has them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.sources.gate.labels import label_fault
from racines_data.sources.table.mapping import Mapping
from racines_data.sources.table.rows import numbers, texts
from racines_data.views import RANDOM, VIEWS, check_labels

_NEWTONS = {"N": 1.0, "mN": 1e-3, "gf": 9.80665e-3}
_NEWTON_METRES = {"N·m": 1.0, "N·mm": 1e-3}


class Labelled(NamedTuple):
    """What a sweep's rows say beside poses."""

    views: np.ndarray
    """(T,) int64, -1 where unknown."""
    grades: np.ndarray
    """(T,) float32, NaN where unknown."""
    target: str
    session: str
    """Empty where no column says."""


def labels_of(mapping: Mapping) -> tuple[str, ...]:
    """Return the names of the views, `Random` last.

    Raises:
        RacinesError: a name stands twice, is empty, is `Random`, or cannot name a file.
    """
    views = mapping.labels.views or VIEWS
    if len(set(views)) < len(views) or not all(views) or RANDOM in views:
        raise RacinesError(f"labels.views: {', '.join(views)}: names, each once, without {RANDOM}")
    return (*check_labels(views, "labels.views"), RANDOM)


def read_labels(table: pl.DataFrame, mapping: Mapping, path: Path) -> Labelled:
    """Return the labels of T rows.

    Raises:
        RacinesError: a view that is none of the mapping's, a grade beyond 0-10 or that does not go
            with its view, or a target or session that changes within the sweep.
    """
    said, count = mapping.labels, len(table)
    views, grades = np.full(count, -1), np.full(count, np.nan, np.float32)
    if said.view is not None:
        shown = texts(table, said.view, "labels.view", path)
        views = np.array([_view(each, mapping, "view", path) for each in shown])
    if said.grade is not None:
        grades = numbers(table, [said.grade], "labels.grade", path)[:, 0].astype(np.float32)
        if ((grades < 0) | (grades > 10)).any():
            row = int(np.flatnonzero((grades < 0) | (grades > 10))[0])
            raise RacinesError(
                f"{path}: labels.grade: {grades[row]:g} in row {row}: grades go from 0 to 10"
            )
    if fault := label_fault(views, grades, labels_of(mapping)):
        row, what = fault
        raise RacinesError(
            f"{path}: labels.grade: row {row} is {what}: give its view, a grade from 1 to 10, or "
            f"no grade (of {RANDOM}: 0 or none)"
        )
    target = _one(table, said.target_view, "labels.target_view", path)
    label = _view(target, mapping, "target_view", path)
    session = _one(table, said.session, "labels.session", path)
    return Labelled(views, grades, labels_of(mapping)[label], session)


def _view(text: str, mapping: Mapping, field: str, path: Path) -> int:
    """Return the label of a view's name; -1, which is `Random` as a target, for none."""
    if not text:
        return -1
    labels = labels_of(mapping)
    name = mapping.labels.names.get(text, text)
    if name not in labels:
        raise RacinesError(
            f"{path}: labels.{field}: {text!r} is none of {', '.join(labels)}: give labels.views, "
            "or labels.names"
        )
    return labels.index(name)


def _one(table: pl.DataFrame, name: str | None, field: str, path: Path) -> str:
    if name is None:
        return ""
    values = dict.fromkeys(texts(table, name, field, path))
    if len(values) > 1:
        shown = ", ".join(map(repr, list(values)[:3]))
        raise RacinesError(f"{path}: {field}: column {name!r} changes within a sweep ({shown})")
    return next(iter(values))


def read_controls(table: pl.DataFrame, mapping: Mapping, path: Path) -> np.ndarray:
    """Return (T, 6) float32 m/s and rad/s, NaN where unknown."""
    if mapping.controls is None:
        return np.full((len(table), 6), np.nan, np.float32)
    values = numbers(table, mapping.controls.columns, "controls.columns", path)
    values[:, :3] *= 1e-3 if mapping.controls.unit == "mm/s" else 1.0
    if mapping.controls.turn_unit == "deg/s":
        values[:, 3:] = np.radians(values[:, 3:])
    return values.astype(np.float32)


def read_wrench(table: pl.DataFrame, mapping: Mapping, path: Path) -> np.ndarray | None:
    """Return (T, 6) N and N·m, NaN where unknown; None where none were measured."""
    if mapping.forces is None:
        return None
    values = numbers(table, mapping.forces.columns, "forces.columns", path)
    made = np.full((len(table), 6), np.nan)
    made[:, : values.shape[1]] = values
    made[:, :3] *= _NEWTONS[mapping.forces.unit]
    made[:, 3:] *= _NEWTON_METRES[mapping.forces.torque_unit]
    return made
