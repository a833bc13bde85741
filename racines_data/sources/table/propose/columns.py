"""What the columns of a table are, by their names first and their numbers second."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl

from racines_data.sources.gate.numbers import likely_unit, rotation_faults
from racines_data.sources.table.clocks import SECONDS
from racines_data.sources.table.doubts.names import axis_of, unit_of
from racines_data.sources.table.poses import UNIT, laid_out

_TURNING = {"r", "rot", "rotation", "euler", "angle", "angles", "ang", "rpy", "orientation", "ori"}
_VECTOR = {"rotvec", "rv", "axisangle"}
_FORCE, _TORQUE = {"f", "force"}, {"torque", "tau", "moment", "m"}
_MOVING = {"v", "vel", "velocity", "w", "omega", "twist", "control", "cmd", "acc", "a", "gyro", "u"}
_TIMES = ("t", "time", "timestamp", "stamp", "time_s", "time_ms", "seconds", "secs", "sec")
_PLACE = re.compile(r"^(.*?)([0-3])[_ ,]?([0-3])\]?$")
SWEEPS = ("sweep", "trajectory", "sequence", "scan", "run", "series", "trial", "recording", "seq")
VIEWS, GRADES = ("view", "plane", "label"), ("grade", "quality")
TARGETS, SESSIONS = ("target_view", "target", "aim"), ("session", "patient", "subject", "day")


@dataclass
class Guess:
    """Parts of a mapping, and why each was taken."""

    parts: dict[str, Any] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    """By the field's path."""


def guess_columns(table: pl.DataFrame) -> Guess:
    """Return `time`, `position`, `rotation` and `forces` as far as the columns tell."""
    made = Guess()
    numeric = [name for name, kind in table.schema.items() if kind.is_numeric()]
    _time(table, numeric, made)
    triples = dict(_groups(numeric, "xyz"))
    _rotation(table, numeric, triples, made)
    _position(table, triples, made)
    _forces(triples, made)
    return made


def words_of(prefix: str) -> set[str]:
    """Return the words of a group's name."""
    return set(re.findall(r"[a-z]+", prefix))


def _groups(names: Sequence[str], axes: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the columns of each prefix that has every axis, in the order of `axes`."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        if axis := axis_of(name):
            plain = re.sub(r"\s*[\[(].*$", "", name.lower())
            if kind := next((k for k in ("length", "angle") if unit_of(name, k)), ""):
                plain = re.sub(r"[_ .]?(?:mm|cm|m|deg|rad)$", "", plain) if kind else plain
            prefix = re.sub(r"(roll|pitch|yaw)$", "rpy", plain)
            prefix = prefix if prefix != plain else plain[::-1].replace(axis, "", 1)[::-1]
            found.setdefault(prefix.strip("_. "), {}).setdefault(axis, name)
    for prefix, columns in found.items():
        if all(axis in columns for axis in axes):
            yield prefix, [columns[axis] for axis in axes]


def _time(table: pl.DataFrame, numeric: Sequence[str], made: Guess) -> None:
    bare = {re.sub(r"[\[(\s].*$", "", name.lower()): name for name in table.columns}
    name = next((bare[word] for word in _TIMES if word in bare), None)
    name = name or next((n for n in table.columns if "time" in n.lower()), None)
    if name is None:
        made.parts["time"] = {"rate": 25.0}
        made.notes["poses.time"] = "NO COLUMN OF TIMES FOUND: give the true rate"
        return
    if name not in numeric:
        made.parts["time"] = {"column": name, "unit": "iso"}
        return
    unit, steps = unit_of(name, "time"), np.diff(table[name].cast(pl.Float64).to_numpy())
    steps = steps[steps > 0]
    if not unit and len(steps):
        step = float(np.median(steps))
        unit = likely_unit(step, SECONDS, 1e-3, 5.0, 0.04) or "s"
        made.notes["poses.time.unit"] = f"by its numbers: {step:.4g} from row to row"
    made.parts["time"] = {"column": name, "unit": unit or "s"}


def _rotation(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> None:
    for find in (_quaternion, _matrix, _listed, _angles, _unnamed):
        if (found := find(table, numeric, triples, made)) is not None:
            made.parts["rotation"] = found
            return


def _quaternion(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> dict[str, Any] | None:
    named = [columns for _, columns in _groups(numeric, "wxyz") if _is_unit(table, columns)]
    for columns in named:
        for name in columns:
            for prefix in [key for key, each in triples.items() if name in each]:
                del triples[prefix]
        first = min(columns, key=list(numeric).index)
        order = "wxyz" if axis_of(first) == "w" else "xyzw"
        ordered = columns if order == "wxyz" else [*columns[1:], columns[0]]
        return {"kind": "quaternion", "columns": ordered, "order": order}
    return None


def _unnamed(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> dict[str, Any] | None:
    """Return four neighbours of unit length whose names say nothing.

    Where they end in 0 to 3, number 0 is w, as books and most drivers have it.
    """
    for start in range(len(numeric) - 3):
        columns = list(numeric[start : start + 4])
        if sorted(name[-1] for name in columns) == ["0", "1", "2", "3"]:
            columns.sort(key=lambda name: name[-1])
        moving = all(table[name].n_unique() > 1 for name in columns)
        if moving and _is_unit(table, columns) and not any(map(axis_of, columns)):
            made.notes["poses.rotation.order"] = "A GUESS: the names do not tell; compare a picture"
            return {"kind": "quaternion", "columns": columns, "order": "wxyz"}
    return None


def _is_unit(table: pl.DataFrame, columns: Sequence[str]) -> bool:
    values = table.select(columns).cast(pl.Float64).drop_nulls().drop_nans().to_numpy()
    return len(values) > 0 and bool(
        (np.abs(np.linalg.norm(values, axis=1) - 1) < UNIT).mean() > 0.9
    )


def _matrix(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> dict[str, Any] | None:
    found: dict[str, dict[tuple[int, int], str]] = {}
    for name in numeric:
        if match := _PLACE.match(name.lower()):
            found.setdefault(match[1], {})[int(match[2]), int(match[3])] = name
    for places in found.values():
        if len(places) in (9, 12, 16):
            return _with_unit([places[key] for key in sorted(places)], table, made)
    for start in range(len(numeric) - 15):
        columns = list(numeric[start : start + 16])
        if (table[columns[15]] == 1).all() and _rigid(_values(table, columns)):
            return _with_unit(columns, table, made)
    return None


def _values(table: pl.DataFrame, columns: Sequence[str]) -> np.ndarray:
    return table.select(columns).cast(pl.Float64).drop_nulls().drop_nans().to_numpy()


def _rigid(values: np.ndarray, layout: str = "rows") -> bool:
    faults = rotation_faults(laid_out(values[:200], layout), 5e-3) if len(values) else [None]
    return len(values) > 0 and sum(fault is None for fault in faults) > 0.8 * len(faults)


def _with_unit(columns: list[str], table: pl.DataFrame, made: Guess) -> dict[str, Any]:
    values = _values(table, columns)
    return {"kind": "matrix", "columns": columns, **_shape(values, made)}


def _shape(values: np.ndarray, made: Guess) -> dict[str, Any]:
    layout = "rows" if _rigid(values) or not _rigid(values, "columns") else "columns"
    shape: dict[str, Any] = {"layout": layout}
    if values.shape[1] > 9 and len(values):
        shape["unit"] = _length(laid_out(values, layout)[:, :3, 3], made, "poses.rotation.unit")
    return shape


def _listed(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> dict[str, Any] | None:
    for name, kind in table.schema.items():
        if not kind.is_nested():
            continue
        rows = [np.ravel(each) for each in table[name].to_list() if each is not None]
        size = len(rows[0]) if rows else 0
        if size not in (9, 12, 16) or any(len(r) != size or r.dtype.kind not in "if" for r in rows):
            continue
        return {"kind": "matrix", "columns": [name], **_shape(np.stack(rows).astype(float), made)}
    return None


def _angles(
    table: pl.DataFrame, numeric: Sequence[str], triples: dict[str, list[str]], made: Guess
) -> dict[str, Any] | None:
    for prefix in list(triples):
        words = words_of(prefix)
        if not words & (_TURNING | _VECTOR):
            continue
        columns = triples.pop(prefix)
        largest = float(np.abs(_values(table, columns)).max(initial=0))
        unit = unit_of(columns[0], "angle") or ("deg" if largest > 2 * np.pi else "rad")
        made.notes["poses.rotation.unit"] = f"angles reach {largest:.4g}"
        if words & _VECTOR:
            return {"kind": "vector", "columns": columns, "unit": unit}
        note = "A GUESS: xyz turns about fixed axes (roll, pitch, yaw); see docs/table.md"
        made.notes["poses.rotation.order"] = note
        return {"kind": "euler", "columns": columns, "order": "xyz", "unit": unit}
    return None


def _position(table: pl.DataFrame, triples: dict[str, list[str]], made: Guess) -> None:
    rotation = made.parts.get("rotation", {})
    if rotation.get("unit") in ("m", "cm", "mm"):
        return
    other = _TURNING | _VECTOR | _FORCE | _TORQUE | _MOVING
    fits = [prefix for prefix in triples if not words_of(prefix) & other]
    fits.sort(key=lambda prefix: (words_of(prefix) == {"t"}, len(prefix)))
    if not fits:
        return
    columns = triples.pop(fits[0])
    unit = unit_of(columns[0], "length")
    unit = unit or _length(_values(table, columns), made, "poses.position.unit")
    made.parts["position"] = {"columns": columns, "unit": unit}


def _length(values: np.ndarray, made: Guess, path: str) -> str:
    size = float(np.median(np.linalg.norm(values[np.isfinite(values).all(1)], axis=1)))
    made.notes[path] = f"by its numbers: {size:.4g} from the origin"
    return likely_unit(size, {"m": 1.0, "mm": 1e-3}, 0.01, 10.0) or "m"


def _forces(triples: dict[str, list[str]], made: Guess) -> None:
    force = next((each for prefix, each in triples.items() if words_of(prefix) & _FORCE), None)
    if force is None:
        return
    torque = next(
        (each for prefix, each in triples.items() if words_of(prefix) & (_TORQUE | {"t"})), []
    )
    made.parts["forces"] = {"columns": [*force, *torque]}
