"""What single numbers say: units of length, angle and time, no rotations, counters."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from racines_data.sources.gate.bounds import TRACKER, Bounds
from racines_data.sources.gate.numbers import LENGTH_KINDS, LENGTHS, likely_unit, rotation_faults
from racines_data.sources.images import Kind
from racines_data.sources.table.clocks import SECONDS
from racines_data.sources.table.doubts.base import Doubt
from racines_data.sources.table.mapping import (
    Euler,
    Mapping,
    Quaternion,
    RotationMatrix,
    RotationVector,
)
from racines_data.sources.table.poses import UNIT, laid_out
from racines_data.sources.table.rows import numbers
from racines_data.sources.table.sweeps import Draft, Sweep

_MOST = 0.5
"""Share of the rows from which on a fault is one of the mapping, and not of the rows."""
_FEWEST = 6
_DISTANCE, _PACE = 0.5, 0.01
"""Ordinary distance of a probe from the origin, m, and its ordinary speed, m/s."""
_COLUMN = 0.1
"""So near to the origin stands a robot's own first joint, and no probe, m."""
_WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}


def value_doubts(mapping: Mapping, drafts: Sequence[Draft], bounds: Bounds) -> Iterator[Doubt]:
    """Yield what the numbers of all sweeps contradict."""
    yield from _times(mapping, drafts, bounds)
    rotation = mapping.poses.rotation
    wrong = (
        list(_matrices(mapping, drafts, rotation)) if isinstance(rotation, RotationMatrix) else []
    )
    yield from wrong
    if isinstance(rotation, Quaternion):
        yield from _quaternions(drafts, rotation)
    elif isinstance(rotation, Euler | RotationVector):
        yield from _angles(drafts, rotation)
    if not wrong or mapping.poses.position is not None:  # the matrix may hold the position
        yield from _lengths(mapping, drafts, bounds)
    yield from _counters(mapping, drafts)


def _times(mapping: Mapping, drafts: Sequence[Draft], bounds: Bounds) -> Iterator[Doubt]:
    time = mapping.poses.time
    if time.column is None or time.unit == "iso":
        return
    known = [draft.times[np.isfinite(draft.times)] for draft in drafts]
    steps = np.concatenate([np.diff(each) for each in known])
    if not len(steps):
        return
    field, step = "poses.time", float(np.median(steps))
    if step < 0:
        detail = f"times run backwards, {-step:.3g} s from row to row"
        yield Doubt("backwards", f"{field}.column", detail, "sort the rows by time")
    elif step > bounds.longest or 0 < step < bounds.shortest:
        raw = step / SECONDS[time.unit]
        others = {name: each for name, each in SECONDS.items() if name != time.unit}
        unit = likely_unit(raw, others, bounds.shortest, bounds.longest, 0.04)
        detail = f"{step:.3g} s from row to row when read in {time.unit}"
        name = _WORDS[unit] if unit else "unit of time"
        remedy = f"set unit: {unit}" if unit else "name the column of the time"
        yield Doubt(name, f"{field}.unit", detail, remedy)
    elif step == 0:
        detail = "most times are those of the row before"
        yield Doubt("frozen clock", f"{field}.column", detail, "name the column of the time")
    elif len(steps) >= _FEWEST and time.unit == "s" and (steps == 1).all():
        detail = f"column {time.column!r} counts 1, 2, 3, …"
        remedy = "give time as {rate: rows a second}"
        name = "frame numbers for times"
        yield Doubt(name, f"{field}.column", detail, remedy, certain=False)


def _lengths(mapping: Mapping, drafts: Sequence[Draft], bounds: Bounds) -> Iterator[Doubt]:
    position, rotation = mapping.poses.position, mapping.poses.rotation
    unit = position.unit if position is not None else getattr(rotation, "unit", None)
    field = "poses.position.unit" if position is not None else "poses.rotation.unit"
    places = np.concatenate([draft.poses[:, :3, 3] for draft in drafts])
    size = np.linalg.norm(places[np.isfinite(places).all(1)], axis=1)
    if not len(size) or unit not in LENGTHS:
        return
    # Before a tracker's frame is carried into the robot's, it may be farther away.
    moved = mapping.calibration.tracker_to_base is not None or mapping.poses.invert
    reach = max(bounds.reach, TRACKER.reach) if moved else bounds.reach
    usual, largest = float(np.median(size)), float(size.max())
    others = {name: each / LENGTHS[unit] for name, each in LENGTHS.items() if name != unit}
    detail = f"the probe is {usual:.4g} m from the origin when read in {unit}"
    if usual > reach or largest < bounds.nearest:
        low = max(bounds.nearest, 0.01)
        fits = _likely_lengths(usual, _speed(drafts, bounds), others, low, reach)
        name = str(LENGTH_KINDS[fits[0]]) if fits else str(Kind.OUT_OF_REACH)
        remedy = _set_unit(fits) if fits else "name the columns of the position"
        if not fits and bounds.reach < TRACKER.reach and usual <= TRACKER.reach:
            field, remedy = "frame", f"beyond a robot's {bounds.reach:g} m: set frame: tracker"
        yield Doubt(name, field, detail, remedy)
    elif mapping.frame == "robot" and not moved and largest < _COLUMN:
        fits = _likely_lengths(usual, _speed(drafts, bounds), others, _COLUMN, reach)
        if fits:
            detail += f", and within {_COLUMN:g} m of it stands a robot's own base"
            remedy = f"{_set_unit(fits)}, or frame: tracker if the origin is no robot's base"
            yield Doubt(str(LENGTH_KINDS[fits[0]]), field, detail, remedy, certain=False)


def _set_unit(fits: Sequence[str]) -> str:
    return f"set unit: {fits[0]}" + (f" ({fits[1]} fits too)" if len(fits) > 1 else "")


def _likely_lengths(
    size: float, speed: float, ratios: dict[str, float], low: float, high: float
) -> list[str]:
    """Return the units in which a probe would lie within [low, high] m, the likely one first.

    A distance of 197 may be millimetres or centimetres: then the speed tells, where it is known.
    """

    def unlikely(unit: str) -> float:
        moved = abs(math.log(speed * ratios[unit] / _PACE)) if speed > 0 else 0.0
        return abs(math.log(size * ratios[unit] / _DISTANCE)) + moved

    return sorted(
        (unit for unit, each in ratios.items() if low <= size * each <= high), key=unlikely
    )


def _speed(drafts: Sequence[Draft], bounds: Bounds) -> float:
    """Return the usual speed of the probe as read, m/s; 0 where the times do not tell."""
    found = [np.zeros(0)]
    for draft in drafts:
        steps = np.diff(draft.times)
        moved = np.linalg.norm(np.diff(draft.poses[:, :3, 3], axis=0), axis=1)
        good = (steps >= bounds.shortest) & (steps <= bounds.longest) & np.isfinite(moved)
        found.append(moved[good] / steps[good])
    speeds = np.concatenate(found)
    return float(np.median(speeds)) if len(speeds) else 0.0


def _quaternions(drafts: Sequence[Draft], rotation: Quaternion) -> Iterator[Doubt]:
    values = np.concatenate([_numbers(draft, rotation.columns) for draft in drafts])
    length = np.linalg.norm(values[np.isfinite(values).all(1)], axis=1)
    wrong = np.abs(length - 1) > UNIT
    if len(length) and wrong.mean() > _MOST:
        usual, field = float(np.median(length)), "poses.rotation.columns"
        remedy = f"name the four of the quaternion; divide them by {usual:.4g} if they are scaled"
        if np.ptp(length) > 0.01 * usual:
            remedy = "they are no rotation; name the four columns of the quaternion"
        detail = f"{', '.join(rotation.columns)} have length {usual:.4g}, where 1 is a rotation"
        yield Doubt("no quaternion", field, detail, remedy)


def _matrices(
    mapping: Mapping, drafts: Sequence[Draft], rotation: RotationMatrix
) -> Iterator[Doubt]:
    tolerance = mapping.poses.tolerance
    given = np.concatenate([draft.poses for draft in drafts])
    given = given[np.isfinite(given).all((1, 2))]
    faults = [fault for fault in rotation_faults(given, tolerance) if fault]
    if not len(given) or len(faults) <= _MOST * len(given):
        return
    values = np.concatenate([_numbers(draft, rotation.columns) for draft in drafts])
    values = values[np.isfinite(values).all(1)]
    other = "columns" if rotation.layout == "rows" else "rows"
    sound = sum(fault is None for fault in rotation_faults(laid_out(values, other), tolerance))
    detail = f"{len(faults)} of {len(given)} rows: {faults[0]}"
    if sound > _MOST * len(values):
        yield Doubt("transposed", "poses.rotation.layout", detail, f"set layout: {other}")
    elif faults[0].kind is Kind.REFLECTED:
        remedy = "an axis is mirrored, in the log or by the order of the columns; turn it round"
        yield Doubt("mirrored", "poses.rotation", detail, remedy)
    elif faults[0].kind is Kind.NOT_RIGID:
        remedy = "name the 16 numbers of the pose in their order"
        yield Doubt("no rigid pose", "poses.rotation.columns", detail, remedy)
    else:
        remedy = "name the columns in their order, or raise poses.tolerance"
        yield Doubt("no rotation", "poses.rotation.columns", detail, remedy)


def _angles(drafts: Sequence[Draft], rotation: Euler | RotationVector) -> Iterator[Doubt]:
    values = np.concatenate([_numbers(draft, rotation.columns) for draft in drafts])
    values = values[np.isfinite(values).all(1)]
    if not len(values):
        return
    field, largest = "poses.rotation.unit", float(np.abs(values).max())
    shown = f"angles reach {largest:.4g}"
    if rotation.unit == "rad" and largest > 2 * math.pi:
        detail = f"{shown}, and a whole turn is 6.28 rad"
        yield Doubt("degrees", field, detail, "set unit: deg", certain=largest > 4 * math.pi)
    elif rotation.unit == "deg" and 0.02 < largest <= math.pi + 1e-3:
        detail = f"{shown}, and half a turn is 3.14 rad"
        yield Doubt("radians", field, detail, "set unit: rad", certain=False)


def image_doubts(sweeps: Sequence[Sweep]) -> Iterator[Doubt]:
    """Yield whether most rows name an image that others name too."""
    for sweep in sweeps:
        paths = getattr(sweep.stack, "paths", None)
        if paths is None or len(sweep.images) < _FEWEST:
            continue
        files = {paths[place] for place in sweep.images}
        if len(files) <= _MOST * len(sweep.images):
            detail = f"{len(sweep.images)} rows of sweep {sweep.name} name {len(files)} image(s)"
            remedy = "name the column that tells images apart"
            yield Doubt("frozen frames", "images.path", detail, remedy, certain=False)
            return


def _counters(mapping: Mapping, drafts: Sequence[Draft]) -> Iterator[Doubt]:
    """Yield a position that counts rows."""
    if mapping.poses.position is None:
        return
    for axis, name in enumerate(mapping.poses.position.columns):
        if len(mapping.poses.position.columns) < 3:
            return
        values = [_numbers(draft, [name])[:, 0] for draft in drafts]
        steps = np.concatenate([np.diff(each) for each in values])
        if len(steps) >= _FEWEST and (steps == 1).all():
            detail = f"column {name!r}, taken for {'xyz'[axis]}, counts 1, 2, 3, …"
            field, remedy = "poses.position.columns", "name the column of the position"
            yield Doubt("a counter for a position", field, detail, remedy, certain=False)


def _numbers(draft: Draft, columns: Sequence[str]) -> np.ndarray:
    return numbers(draft.table, columns, "poses.rotation.columns", draft.path)
