"""What single numbers say: rotations that are none, positions and forces in other units, clocks.

What reads files (`release`, `tracked`) asks for the fault of each frame, in order to refuse that
frame; what checks a trajectory refuses it whole.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from racines_data.schema import CONTROLS, PARAMETERS, Trajectory
from racines_data.sources.gate.bounds import Bounds
from racines_data.sources.images import Fault, Kind

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Metres of each unit that a position may be in."""
LENGTH_KINDS = {"m": Kind.METRES, "cm": Kind.CENTIMETRES, "mm": Kind.MILLIMETRES}
TOLERANCE = 1e-3
"""Largest error of a rotation's orthonormality, per element of R Rᵀ - 1."""
_FORCES = {"grams-force (0.00981 N)": 9.80665e-3, "millinewtons": 1e-3}
_TORQUES = {"N·cm": 1e-2, "N·mm": 1e-3, "grams-force times cm": 9.80665e-5}
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_CLIPPED = 0.1
"""Share of frames with rotation_y at ±π/2, to the last bits, that no probe has by chance."""
_USUAL = {"length": 0.5, "force": 10.0, "torque": 1.0, "time": 0.04}
"""Ordinary sizes of what is recorded: of several units, the likely one comes nearest to it."""


def likely_unit(
    size: float, units: Mapping[str, float], low: float, high: float, usual: float = 0.5
) -> str | None:
    """Return the unit in which a size lies within [low, high], nearest to the usual; or None."""
    fits = {name: size * each for name, each in units.items() if low <= size * each <= high}
    return min(fits, key=lambda name: abs(math.log(fits[name] / usual)), default=None)


def rotation_faults(
    matrices: np.ndarray, tolerance: float = TOLERANCE, item: str = ""
) -> list[Fault | None]:
    """Return why each of (T, 4, 4) matrices is no rigid right-handed pose, or None."""
    rotation = matrices[:, :3, :3]
    gram = rotation @ rotation.transpose(0, 2, 1)
    error = np.abs(gram - np.eye(3)).max((1, 2), initial=0)
    handed = np.linalg.det(rotation)
    faults: list[Fault | None] = []
    for index, matrix in enumerate(matrices):
        if not np.isfinite(matrix).all():
            fault = Fault(Kind.NAN, "the pose has numbers that are not finite", item)
        elif (matrix[3] != [0, 0, 0, 1]).any():
            detail = f"its last row is {matrix[3]}"
            if (matrix[:3, 3] == 0).all() and matrix[3, 3] == 1:
                detail += "; the matrix is likely transposed: give the position as last column"
            fault = Fault(Kind.NOT_RIGID, detail, item)
        elif error[index] > tolerance:
            detail = f"R Rᵀ differs from 1 by {error[index]:.2g}, more than {tolerance:g}"
            fault = Fault(Kind.NOT_ORTHONORMAL, detail + _scaled(gram[index], tolerance), item)
        elif handed[index] < 0:
            fault = Fault(Kind.REFLECTED, "its determinant is -1: left-handed", item)
        else:
            fault = None
        faults.append(fault)
    return faults


def _scaled(gram: np.ndarray, tolerance: float) -> str:
    """Say so if a matrix is a rotation times a number."""
    square = float(np.trace(gram)) / 3
    if square > 0 and np.abs(gram / square - np.eye(3)).max() <= tolerance:
        return f"; it is not unit: a rotation times {math.sqrt(square):.4g}; divide by that"
    return ""


def check_poses(matrices: np.ndarray, tolerance: float = TOLERANCE) -> None:
    """Refuse (T, 4, 4) matrices of which one is no rigid right-handed pose.

    Raises:
        RacinesError: which frame, and why.
    """
    for frame, fault in enumerate(rotation_faults(matrices, tolerance, "rotation")):
        if fault:
            raise Fault(fault.kind, f"frame {frame}: {fault.detail}", fault.item)


def runs_on(times: np.ndarray, repeats: bool = False) -> np.ndarray:
    """Return (T - 1,) whether each of (T,) times is after the one before; `repeats`: or equal."""
    steps = np.diff(times)
    return steps >= 0 if repeats else steps > 0


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


def number_faults(trajectory: Trajectory, bounds: Bounds) -> Iterator[Fault]:
    """Yield what is wrong with the numbers of a trajectory that has poses, the first first."""
    values = trajectory.parameters
    bad = ~np.isfinite(values)
    bad[:, :6] = np.isinf(values[:, :6])  # a force may be absent
    if bad.any():
        row, column = np.argwhere(bad)[0]
        detail = f"{PARAMETERS[column]} of frame {row} is not finite: every pose needs numbers"
        yield Fault(Kind.NAN, detail)
        return
    yield from _times(trajectory.timestamps, bounds)
    yield from _positions(values[:, 6:9], bounds)
    yield from _angles(values[:, 9:].astype(float))
    yield from _forces(values[:, :6], bounds)
    yield from _controls(trajectory.controls, bounds)


def _times(times: np.ndarray, bounds: Bounds) -> Iterator[Fault]:
    if not bounds.clock:
        if not np.isnan(times).all():
            detail = "has times, where its source says that there is no clock: give NaN"
            yield Fault(Kind.CLOCK, detail, "timestamp")
        return
    if not np.isfinite(times).all():
        row = int(np.flatnonzero(~np.isfinite(times))[0])
        detail = f"frame {row} has none: timestamps must be finite seconds that increase"
        yield Fault(Kind.CLOCK, detail, "timestamp")
        return
    steps, wrong = np.diff(times), ~runs_on(times, bounds.repeats)
    if len(steps) and (steps <= 0).all() and (steps < 0).any():
        detail = f"runs backwards, from {times[0]:g} to {times[-1]:g} s: reverse the frames"
        yield Fault(Kind.CLOCK, detail + " (images and poses too)", "timestamp")
    elif (steps < 0).any():
        row = int(np.flatnonzero(steps < 0)[0]) + 1
        detail = f"decreases at frame {row}, by {-steps[row - 1]:g} s: sort the frames by time"
        yield Fault(Kind.CLOCK, detail, "timestamp")
    elif wrong.any():
        row = int(np.flatnonzero(wrong)[0]) + 1
        detail = (
            f"{int((steps == 0).sum())} frames repeat the time before, first frame {row}: give "
            "each frame its own, or drop it"
        )
        yield Fault(Kind.CLOCK, detail, "timestamp")
    step = float(np.median(steps)) if len(steps) else 0.0
    if step > bounds.longest:
        unit = likely_unit(step, _TIMES, bounds.shortest, 1.0, _USUAL["time"])
        said = f"likely {unit}; multiply by {_TIMES[unit]:g}" if unit else "give seconds"
        yield Fault(Kind.CLOCK, f"{step:g} s from frame to frame: {said}", "timestamp")
    elif 0 < step < bounds.shortest:
        detail = f"{step:g} s from frame to frame: likely minutes, hours or days; give seconds"
        yield Fault(Kind.CLOCK, detail, "timestamp")


def _positions(positions: np.ndarray, bounds: Bounds) -> Iterator[Fault]:
    distance = np.linalg.norm(positions.astype(float), axis=-1)
    row = int(distance.argmax())
    far = distance > bounds.reach
    if far.any():
        unit = likely_unit(float(np.median(distance[far])), LENGTHS, 0.01, bounds.reach)
        said = f"frame {row} lies {distance[row]:.4g} m from the origin, beyond {bounds.reach:g}"
        share = "" if far.all() else f"; {int(far.sum())} of {len(far)} frames do"
        if unit is None:
            yield Fault(Kind.OUT_OF_REACH, f"{said}{share}: give metres", "position")
            return
        mixed = "" if far.all() else "; units are mixed within it"
        detail = f"{said}{share}: likely {unit}, multiply by {LENGTHS[unit]:g}{mixed}"
        yield Fault(LENGTH_KINDS[unit], detail, "position")
    elif distance[row] < bounds.nearest:
        detail = (
            f"no frame is farther than {distance[row]:.3g} m from the origin: likely kilometres, "
            "or millimetres divided twice; give metres"
        )
        yield Fault(Kind.OUT_OF_REACH, detail, "position")
    else:
        yield from _mixed_frames(distance)


def _mixed_frames(distance: np.ndarray) -> Iterator[Fault]:
    """Yield a fault where some frames are a hundred or thousand times nearer than the others."""
    usual = float(np.median(distance))
    small = distance < usual / 50
    if len(distance) < 4 or usual < 0.05 or not small.any():
        return
    # A path that begins at the origin also comes from nearby, but it does not jump.
    ratio = usual / np.maximum(distance[small], 1e-12)
    fits = ((ratio > 50) & (ratio < 200)) | ((ratio > 500) & (ratio < 2000))
    edges = np.flatnonzero(small[1:] != small[:-1])
    pairs = np.sort(np.stack([distance[edges], distance[edges + 1]]), axis=0)
    if fits.all() and (pairs[1] > 25 * pairs[0]).all():
        row = int(np.flatnonzero(small)[0])
        detail = (
            f"frame {row} lies {distance[row]:.3g} m from the origin, most at {usual:.3g} m: units "
            "are mixed within the trajectory; give metres throughout"
        )
        yield Fault(Kind.MIXED_UNITS, detail, "position")


def _angles(angles: np.ndarray) -> Iterator[Fault]:
    size = np.abs(angles)
    row, column = np.unravel_index(size.argmax(), size.shape)
    largest, name = float(size[row, column]), PARAMETERS[9 + int(column)]
    clipped = np.abs(size[:, 1] - math.pi / 2) < 1e-5
    if largest <= math.pi + 1e-5:
        if clipped.sum() > _CLIPPED * len(clipped):
            detail = (
                f"±π/2 in {int(clipped.sum())} of {len(clipped)} frames: likely the arcsine of "
                "more than 1, cut off: matrices or quaternions that are not unit; normalise them"
            )
            yield Fault(Kind.NOT_ORTHONORMAL, detail, PARAMETERS[10])
        return
    if largest > 2 * math.pi:
        detail = f"{largest:.4g} in frame {row}: likely degrees; multiply by π/180"
        yield Fault(Kind.DEGREES, f"{detail} (or radians unwrapped: wrap them)", name)
    else:
        detail = f"{largest:.4g} in frame {row} exceeds ±π: wrap the angles, rad"
        yield Fault(Kind.DEGREES, detail, name)


def _forces(wrench: np.ndarray, bounds: Bounds) -> Iterator[Fault]:
    kinds = (
        ("force", "N", slice(0, 3), bounds.force, _FORCES),
        ("torque", "N·m", slice(3, 6), bounds.torque, _TORQUES),
    )
    for name, si, part, limit, units in kinds:
        values = np.abs(wrench[:, part].astype(float))
        known = values[~np.isnan(values).any(1)]
        if not len(known):
            continue
        largest, usual = float(known.max()), float(np.median(np.linalg.norm(known, axis=1)))
        if largest <= limit and usual <= limit / 2:
            continue
        unit = likely_unit(usual, units, 0.01, limit / 2, _USUAL[name])
        said = f"likely {unit}; multiply by {units[unit]:g}" if unit else f"give {si}"
        detail = f"up to {largest:.4g} {si}, median {usual:.4g}, where ±{limit:g} is plausible"
        yield Fault(Kind.FORCE_UNIT, f"{detail}: {said}", name)


def _controls(controls: np.ndarray, bounds: Bounds) -> Iterator[Fault]:
    if np.isinf(controls).any():
        row, column = np.argwhere(np.isinf(controls))[0]
        yield Fault(Kind.INFINITE, f"frame {row}: give a number, or NaN", CONTROLS[column])
        return
    limits = (
        ("m/s: likely mm/s or cm/s", 0, bounds.speed),
        ("rad/s: likely degrees/s", 3, bounds.spin),
    )
    for said, first, limit in limits:
        values = np.abs(controls[:, first : first + 3])
        if np.isnan(values).all():
            continue
        row, column = np.unravel_index(np.nanargmax(values), values.shape)
        if values[row, column] > limit:
            detail = f"{values[row, column]:.4g} in frame {row}, beyond {limit:g} {said}"
            yield Fault(Kind.CONTROL_UNIT, detail, CONTROLS[first + int(column)])
