"""What the names of columns say of themselves, against what the mapping takes them for.

A quaternion read in another order turns by the same angles from frame to frame, and so does a
transposed matrix: mostly, names are all that tells. Only names that say something are held
against it: `qw`, `rot_z`, `x_mm`, `r12`, `T_probe_to_tracker`.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any

from racines_data.sources.table.doubts.base import Doubt
from racines_data.sources.table.mapping import (
    Euler,
    Mapping,
    NoRotation,
    Quaternion,
    RotationMatrix,
)

_UNITS = {
    "length": {"m": "m", "cm": "cm", "mm": "mm", "metres": "m", "meters": "m", "millimetres": "mm"},
    "angle": {"rad": "rad", "deg": "deg", "radians": "rad", "degrees": "deg"},
    "time": {
        "s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "msec": "ms",
        "milliseconds": "ms", "us": "us", "usec": "us", "ns": "ns", "nsec": "ns",
    },
}  # fmt: skip
_BEFORE = "pos|rot|ori|tcp|trans|force|torque|tau|euler|quat|ang"
_TURNS = {"roll": "x", "pitch": "y", "yaw": "z"}
_PLACE = re.compile(r"(?:^|[^a-z])[a-z]{0,3}([0-3])[_ ,]?([0-3])\]?$")
_SENSE = re.compile(r"([a-z]+)[_ ]?(?:to|2)[_ ]?([a-z]+)")
_FIXED = ("tracker", "base", "world", "robot", "reference", "map")
_MOVED = ("probe", "tool", "image", "marker", "sensor", "transducer", "tcp")


def name_doubts(mapping: Mapping) -> Iterator[Doubt]:
    """Yield what the columns' names contradict."""
    poses, rotation = mapping.poses, mapping.poses.rotation
    yield from _twice(mapping)
    if poses.position is not None:
        yield from _axes(poses.position.columns, "xyz", "poses.position.columns")
        yield from _unit(poses.position.columns, poses.position.unit, "length", "poses.position")
    if poses.time.column is not None and poses.time.unit != "iso":
        yield from _unit([poses.time.column], poses.time.unit, "time", "poses.time")
    if isinstance(rotation, Quaternion):
        yield from _axes(rotation.columns, rotation.order, "poses.rotation.order")
    elif isinstance(rotation, Euler):
        yield from _axes(rotation.columns, rotation.order.lower(), "poses.rotation.order")
        yield from _unit(rotation.columns, rotation.unit, "angle", "poses.rotation")
    elif isinstance(rotation, RotationMatrix):
        yield from _places(rotation)
        if rotation.unit is not None:
            yield from _unit(rotation.columns, rotation.unit, "length", "poses.rotation")
    yield from _sense(mapping)
    if mapping.forces is not None:
        letters = "xyzxyz"[: len(mapping.forces.columns)]
        yield from _axes(mapping.forces.columns, letters, "forces.columns")


def _twice(mapping: Mapping) -> Iterator[Doubt]:
    """Yield columns that stand for two things."""
    taken: dict[str, str] = {}
    parts = {"poses.time": mapping.poses.time, "poses.position": mapping.poses.position}
    for field, part in {**parts, "poses.rotation": mapping.poses.rotation}.items():
        columns = getattr(part, "columns", None) or [getattr(part, "column", None)]
        for name in filter(None, columns):
            if name in taken:
                detail = f"column {name!r} is taken for {taken[name]} too"
                yield Doubt("one column twice", field, detail, "name another column")
            taken[name] = field


def axis_of(name: str) -> str:
    """Return the axis that a column's name ends or begins with: w, x, y, z; else nothing."""
    plain = re.sub(r"[\[(].*$", "", name.lower()).rstrip("_ ")
    words = re.split(r"[^a-z0-9]+", plain)
    for word in reversed(words):
        if word in _TURNS:
            return _TURNS[word]
        if any(word in units for units in _UNITS.values()):
            continue
        found = re.fullmatch(rf"(?:[a-z]|{_BEFORE})?([wxyz])\d?", word)
        return found[1] if found else ""
    return ""


def _axes(columns: Sequence[str], order: str, field: str) -> Iterator[Doubt]:
    letters = [axis_of(name) for name in columns]
    if len(columns) != len(order) or "" in letters or sorted(letters) != sorted(order):
        return
    if "".join(letters) == order:
        return
    found, shown = "".join(letters), ", ".join(columns)
    if "w" in order:
        name = "w first" if found.startswith("w") else "w last"
        remedy = f"set order: {found}" if found in ("wxyz", "xyzw") else "list them as the order is"
        detail = f"the columns {shown} are in the order {found}, taken as {order}"
    elif field.endswith("order"):
        name, remedy = "order of angles", f"set order: {found}, or list the columns as {order}"
        detail = f"the columns {shown} turn about {found}, taken as {order}"
    else:
        name, remedy = "swapped columns", f"list them as {', '.join(order)}"
        detail = f"{shown} stand for {', '.join(order)}"
    yield Doubt(name, field, detail, remedy, certain=False)


def unit_of(name: str, kind: str) -> str:
    """Return the unit that a column's name ends with, as x_mm or x (mm); else nothing."""
    found = re.search(r"[\[(]\s*([a-z]+)\s*[\])]\s*$|(?:_|\.| )([a-z]+)$", name.lower())
    word = next(filter(None, found.groups()), "") if found else ""
    return _UNITS[kind].get(word, "")


def _unit(columns: Sequence[str], unit: str, kind: str, field: str) -> Iterator[Doubt]:
    told = {unit_of(name, kind) for name in columns} - {""}
    if len(told) == 1 and (said := told.pop()) != unit:
        names = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "deg": "degrees"}
        names |= {"rad": "radians", "s": "seconds", "ms": "milliseconds", "us": "microseconds"}
        detail = f"{columns[0]} says {said} by its name, taken as {unit}"
        name = names.get(said, said)
        yield Doubt(name, f"{field}.unit", detail, f"set unit: {said}", certain=False)


def tells_order(rotation: Any) -> bool:
    """Return whether the columns' names say in which order a quaternion or a matrix stands."""
    if isinstance(rotation, Quaternion):
        return sorted(map(axis_of, rotation.columns)) == ["w", "x", "y", "z"]
    if isinstance(rotation, RotationMatrix) and len(rotation.columns) > 1:
        return all(_PLACE.search(name.lower()) for name in rotation.columns)
    return False


def _places(rotation: RotationMatrix) -> Iterator[Doubt]:
    """Yield whether names with indices (r12, m_0_1) run by rows or by columns."""
    found = [_PLACE.search(name.lower()) for name in rotation.columns]
    if len(found) < 9 or not all(found):
        return
    places = [(int(each[1]), int(each[2])) for each in found if each]
    by_rows, by_columns = places == sorted(places), places == sorted(places, key=lambda p: p[::-1])
    told = "rows" if by_rows else "columns" if by_columns else ""
    if told and told != rotation.layout:
        shown = ", ".join(rotation.columns[:4])
        detail = f"the columns {shown}, … run by {told}, taken by {rotation.layout}"
        field = "poses.rotation.layout"
        yield Doubt("transposed", field, detail, f"set layout: {told}", certain=False)


def _sense(mapping: Mapping) -> Iterator[Doubt]:
    """Yield whether a name tells which way a transform goes."""
    poses, rotation = mapping.poses, mapping.poses.rotation
    columns = [] if isinstance(rotation, NoRotation) else [*rotation.columns]
    columns += poses.position.columns if poses.position is not None else []
    for name in columns:
        snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
        for first, last in _SENSE.findall(snake):
            inverse = first in _FIXED and last in _MOVED
            if (inverse or (first in _MOVED and last in _FIXED)) and inverse != poses.invert:
                detail = f"{name} goes from the {first} to the {last} by its name"
                remedy = f"set invert: {str(inverse).lower()}"
                yield Doubt("inverted", "poses.invert", detail, remedy, certain=False)
                return
