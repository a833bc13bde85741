"""Are the numbers of a recording poses of a probe in metres, forces, and a clock that runs on?"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from racines_data.sources.release.kinds import Kind
from racines_data.sources.release.log import CONTROL, FIELDS, POSE, TIME, WRENCH

UNITS = {"m": 1.0, "mm": 1e-3}
UNIT_KINDS = {"m": Kind.METRES, "mm": Kind.MILLIMETRES}
_NEAREST = 0.01
"""No recording has the probe nearer to the middle of the robot's base, m."""


class Fault(NamedTuple):
    """Why a frame cannot be used."""

    kind: Kind
    field: str
    detail: str


class Limits(Protocol):
    """What a frame's numbers are measured by; see `ReleaseConfig`."""

    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def reach(self) -> float: ...  # noqa: D102
    @property
    def tolerance(self) -> float: ...  # noqa: D102
    @property
    def allow_absent(self) -> bool: ...  # noqa: D102
    @property
    def allow_repeats(self) -> bool: ...  # noqa: D102


def check_numbers(rows: np.ndarray, limits: Limits) -> list[Fault | None]:
    """Return what is wrong with each of (T, 29) logs, or None."""
    faults: list[Fault | None] = [None] * len(rows)
    for index in np.flatnonzero(~np.isfinite(rows).all(1)):
        faults[index] = _not_finite(rows[index], limits.allow_absent)
    good = np.flatnonzero([fault is None for fault in faults])
    matrices = rows[good, POSE].reshape(-1, 4, 4)
    rotation = matrices[:, :3, :3]
    error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max((1, 2), initial=0)
    reflected = np.linalg.det(rotation) < 0
    for place, index in enumerate(good):
        if (matrices[place, 3] != [0, 0, 0, 1]).any():
            fault = Fault(Kind.NOT_RIGID, FIELDS[2], f"its last row is {matrices[place, 3]}")
        elif error[place] > limits.tolerance:
            detail = f"R Rᵀ differs from 1 by {error[place]:.2g}, more than {limits.tolerance:g}"
            fault = Fault(Kind.NOT_ORTHONORMAL, FIELDS[2], detail)
        elif reflected[place]:
            fault = Fault(Kind.REFLECTED, FIELDS[2], "its determinant is -1: left-handed")
        else:
            fault = _wrong_unit(matrices[place, :3, 3], limits.unit, limits.reach)
        faults[index] = fault
    return faults


def _not_finite(row: np.ndarray, allow_absent: bool) -> Fault | None:
    for name, part in zip(FIELDS, (slice(TIME, 1), WRENCH, POSE, CONTROL), strict=True):
        values = row[part]
        finite = np.isfinite(values)
        if finite.all():
            continue
        nan = np.isnan(values)
        if allow_absent and part in (WRENCH, CONTROL) and nan.all():
            continue
        kind = Kind.NAN if nan.any() else Kind.INFINITE
        return Fault(kind, name, f"{(~finite).sum()} of {len(values)} numbers are not finite")
    return None


def _wrong_unit(position: np.ndarray, unit: str, reach: float) -> Fault | None:
    distance = float(np.linalg.norm(position))
    if distance * UNITS[unit] <= reach and (unit == "m" or distance * UNITS[unit] >= _NEAREST):
        return None
    read = f"the probe is {distance * UNITS[unit]:.4g} m from the robot when read in {unit}"
    for other, metres in UNITS.items():
        if other != unit and _NEAREST <= distance * metres <= reach:
            detail = f"{read}; the position is likely in {other}"
            return Fault(UNIT_KINDS[other], FIELDS[2], detail)
    return Fault(Kind.OUT_OF_REACH, FIELDS[2], f"{read}; its reach is {reach:g} m")


def backward(times: Sequence[float], allow_repeats: bool) -> list[int]:
    """Return the fewest frames without which the clock only runs forwards.

    All but a longest increasing run: one wrong time costs one frame, wherever it lies. With
    `allow_repeats` the clock may stand still.
    Patience sorting: Aldous and Diaconis, Longest increasing subsequences, 1999.
    """
    find = bisect_right if allow_repeats else bisect_left
    tails: list[float] = []
    places: list[int] = []
    before: list[int] = []
    for index, time in enumerate(times):
        pile = find(tails, time)
        before.append(places[pile - 1] if pile else -1)
        tails[pile : pile + 1] = [time]
        places[pile : pile + 1] = [index]
    kept: set[int] = set()
    index = places[-1] if places else -1
    while index >= 0:
        kept.add(index)
        index = before[index]
    return [index for index in range(len(times)) if index not in kept]
