"""Are the numbers of a recording poses of a probe in metres, forces, and a clock that runs on?"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from racines_data.sources.folder import UNITS, Fault, Kind
from racines_data.sources.release.log import CONTROL, FIELDS, POSE, TIME, WRENCH
from racines_data.views import VIEWS

UNIT_KINDS = {"m": Kind.METRES, "mm": Kind.MILLIMETRES}
_NEAREST = 0.01
"""No recording has the probe nearer to the middle of the robot's base, m."""


@dataclass(frozen=True)
class ReleaseConfig:
    """How the published recordings are read."""

    unit: str = "m"
    """Unit of the positions in the logs: `m` or `mm`."""
    reach: float = 2.0
    """Farthest that the probe can be from the robot's base, m."""
    tolerance: float = 1e-3
    """Largest error of a rotation's orthonormality, per element of R Rᵀ - 1."""
    allow_absent: bool = False
    """Read a force or control effort that is all NaN as not measured, instead of refusing it."""
    allow_repeats: bool = False
    """Keep a frame whose time is that of the frame before: a coarse clock, or a stale log."""
    label_views: bool = False
    """Take the folder as the view of each of its frames. Frames on the way to a view are then
    labelled as that view, which they are not."""
    views: tuple[str, ...] = VIEWS
    """Names of the view folders, beside `Full`."""


def check_numbers(rows: np.ndarray, config: ReleaseConfig) -> list[Fault | None]:
    """Return what is wrong with each of (T, 29) logs, or None."""
    faults: list[Fault | None] = [None] * len(rows)
    for index in np.flatnonzero(~np.isfinite(rows).all(1)):
        faults[index] = _not_finite(rows[index], config.allow_absent)
    good = np.flatnonzero([fault is None for fault in faults])
    matrices = rows[good, POSE].reshape(-1, 4, 4)
    rotation = matrices[:, :3, :3]
    error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max((1, 2), initial=0)
    reflected = np.linalg.det(rotation) < 0
    for place, index in enumerate(good):
        if (matrices[place, 3] != [0, 0, 0, 1]).any():
            fault = Fault(Kind.NOT_RIGID, f"its last row is {matrices[place, 3]}", FIELDS[2])
        elif error[place] > config.tolerance:
            detail = f"R Rᵀ differs from 1 by {error[place]:.2g}, more than {config.tolerance:g}"
            fault = Fault(Kind.NOT_ORTHONORMAL, detail, FIELDS[2])
        elif reflected[place]:
            fault = Fault(Kind.REFLECTED, "its determinant is -1: left-handed", FIELDS[2])
        else:
            fault = _wrong_unit(matrices[place, :3, 3], config.unit, config.reach)
        faults[index] = fault
    return faults


def _not_finite(row: np.ndarray, allow_absent: bool) -> Fault | None:
    for name, part in zip(FIELDS, (slice(TIME, 1), WRENCH, POSE, CONTROL), strict=True):
        values = row[part]
        nan, wrong = np.isnan(values), int((~np.isfinite(values)).sum())
        absent = allow_absent and part in (WRENCH, CONTROL) and nan.all()
        if wrong and not absent:
            kind = Kind.NAN if nan.any() else Kind.INFINITE
            return Fault(kind, f"{wrong} of {len(values)} numbers are not finite", name)
    return None


def _wrong_unit(position: np.ndarray, unit: str, reach: float) -> Fault | None:
    distance = float(np.linalg.norm(position))
    if distance * UNITS[unit] <= reach and (unit == "m" or distance * UNITS[unit] >= _NEAREST):
        return None
    read = f"the probe is {distance * UNITS[unit]:.4g} m from the robot when read in {unit}"
    for other, metres in UNITS.items():
        if other != unit and _NEAREST <= distance * metres <= reach:
            return Fault(UNIT_KINDS[other], f"{read}; the position is likely in {other}", FIELDS[2])
    return Fault(Kind.OUT_OF_REACH, f"{read}; its reach is {reach:g} m", FIELDS[2])


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
    lost = set(range(len(times)))
    index = places[-1] if places else -1
    while index >= 0:
        lost.remove(index)
        index = before[index]
    return sorted(lost)
