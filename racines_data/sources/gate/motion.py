"""What poses, controls and forces say together: mirrored, transposed, another frame, other units.

A mistake is inferred only where another reading of the numbers fits far better than the one given;
recordings whose controls follow nothing, or that have none, pass. Poses are read as extrinsic xyz
Euler angles, so that a mirrored matrix that was turned into angles is a rotation like any other:
only what it disagrees with tells. docs/import.md says what cannot be told.
"""

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
import torch

from racines_data.geometry import euler_to_matrix
from racines_data.schema import Trajectory
from racines_data.sources.gate.bounds import Bounds
from racines_data.sources.images import Fault, Kind

FEWEST = 12
"""Frames from which on motion is held against controls."""
_SMOOTH = 9
"""Frames over which velocities are averaged: tremor and sensors' noise are not commanded."""
_FOLLOWS, _EXPLAINS = 0.8, 0.9
"""Cosines at which motion follows its controls, and at which another reading explains it."""
_UNEXPLAINED = 0.05
"""Share of the energy of motion that controls leave open in sound data, at most."""
_BETTER = 4.0
"""How many times less another reading has to leave open."""
_UP, _MOST, _ENOUGH = 0.3, 0.9, 12
"""The beam's part upwards, the share of frames, and their number, from which it looks up."""
_CONTACT = 2.0  # N: with less, nothing is said of a force's sign
_MOVING = 1e-4  # m/s or rad/s: what is commanded less is at rest
_COMMANDED = 1e-3

Turned = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, ...]]
MIRRORED: dict[str, Turned] = {
    "mirrored along an axis of the probe": lambda x, y, z: (x, -y, z + math.pi),
    "mirrored along x of the base": lambda x, y, z: (x, y, math.pi - z),
    "mirrored along y of the base": lambda x, y, z: (x, y, -z),
    "mirrored along z of the base": lambda x, y, z: (x + math.pi, -y, z),
}
"""What becomes of the angles x, y, z of a rotation whose matrix was mirrored; each is its own
inverse. Mirrored along x, y or z of the probe, the angles differ by half a turn about a probe's
axis, which no motion shows."""

SCALED = (1.25, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Factors of a matrix that is not unit, beyond which its arcsine is cut off."""


def motion_faults(trajectory: Trajectory, bounds: Bounds) -> Iterator[tuple[str, Fault]]:
    """Yield what is likely wrong with the numbers of a trajectory together, and the opinion's name.

    Poses and times must be finite.
    """
    rotation = _matrices(trajectory.parameters[:, 9:].astype(float).T)
    if bounds.upright:
        yield from _looks_up(rotation)
    if bounds.sensor:
        yield from _force_sign(trajectory.parameters[:, 2].astype(float))
    controls, times = trajectory.controls.astype(float), trajectory.timestamps
    if np.isnan(controls).any() or len(times) < FEWEST or (np.diff(times) <= 0).any():
        return
    pose = trajectory.parameters[:, 6:]
    if (pose == pose[0]).all():
        if np.median(np.abs(controls).max(1)) > _COMMANDED:
            detail = (
                f"the pose of all {len(pose)} frames is one, to the last bit, while the controls "
                "command motion: a stale log? give each frame the pose of its time"
            )
            yield "stale-pose", Fault(Kind.FROZEN, detail, "pose")
        return
    wanted = _averaged(controls)
    moved = np.gradient(trajectory.parameters[:, 6:9].astype(float), times, axis=0)
    yield from _linear(_averaged(moved), wanted[:, :3])
    yield from _angular(trajectory.parameters[:, 9:].astype(float).T, times, wanted[:, 3:])


def _matrices(angles: np.ndarray) -> np.ndarray:
    """Return (T, 3, 3) rotations of (3, T) angles."""
    return euler_to_matrix(torch.from_numpy(np.ascontiguousarray(angles.T))).numpy()


def _looks_up(rotation: np.ndarray) -> Iterator[tuple[str, Fault]]:
    share = float((rotation[:, 2, 2] > _UP).mean())
    if share >= _MOST and len(rotation) >= _ENOUGH:
        detail = (
            f"the beam (the probe's z) points up, out of the patient, in {share:.0%} of frames: "
            "z mirrored or the other way, angles of another convention, or a base whose z points "
            "down; turn the frame so that z is up and the beam looks down (rotation_x near ±π)"
        )
        yield "looks-up", Fault(Kind.LOOKS_UP, detail, "rotation")


def _force_sign(force: np.ndarray) -> Iterator[tuple[str, Fault]]:
    pressed = force[np.abs(force) > _CONTACT / 2]
    if len(pressed) < max(4, len(force) // 4) or np.median(pressed) < _CONTACT:
        return
    if (pressed > 0).mean() >= _MOST:
        detail = (
            f"positive in {(pressed > 0).mean():.0%} of the frames in contact, median "
            f"{np.median(pressed):.3g} N: contact pushes the probe back along -z of its own axes; "
            "likely the force on the patient, or in the base frame: turn it, or change its sign"
        )
        yield "force-sign", Fault(Kind.FORCE_SIGN, detail, "force_z")


def _averaged(values: np.ndarray) -> np.ndarray:
    """Return (T - k + 1, …) means over k frames."""
    width = min(_SMOOTH, len(values) // 3)
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    return (total[width:] - total[:-width]) / width


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    size = math.sqrt(float((a * a).sum()) * float((b * b).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _linear(moved: np.ndarray, wanted: np.ndarray) -> Iterator[tuple[str, Fault]]:
    """Hold (T, 3) velocities of the position against those commanded."""
    axes = [axis for axis in range(3) if np.sqrt((wanted[:, axis] ** 2).mean()) > _MOVING]
    if not axes:
        return
    cosines = np.array([[_cosine(moved[:, i], wanted[:, j]) for j in axes] for i in axes])

    def least(order: tuple[int, ...]) -> float:
        return float(min(abs(cosines[i, j]) for i, j in enumerate(order)))

    plain = tuple(range(len(axes)))
    order = plain if least(plain) >= _FOLLOWS else max(itertools.permutations(plain), key=least)
    if least(order) < (_FOLLOWS if order == plain else _EXPLAINS):
        return
    names = ["xyz"[axis] for axis in axes]
    if order != plain and least(plain) < _FOLLOWS / 2:
        pairs = ", ".join(f"{names[i]} moves as control_{names[j]}" for i, j in enumerate(order))
        detail = f"{pairs}: axes are swapped (a left-handed frame?); give both in the base frame"
        yield "controls", Fault(Kind.REFLECTED, detail, "position")
        return
    if turned := [names[i] for i in plain if order == plain and cosines[i, i] < 0]:
        detail = (
            f"{', '.join(turned)} moves against the velocity commanded: mirrored (a left-handed "
            "frame), or controls of another frame; give both in the right-handed base frame"
        )
        yield "controls", Fault(Kind.REFLECTED, detail, "position")
        return
    if order == plain:
        yield from _slope(moved[:, axes], wanted[:, axes], "position")


def _slope(moved: np.ndarray, wanted: np.ndarray, item: str) -> Iterator[tuple[str, Fault]]:
    slope = float((moved * wanted).sum() / (wanted * wanted).sum())
    if 1 / 8 <= abs(slope) <= 8:
        return
    units = {100.0: "centimetres", 1000.0: "millimetres (or milliseconds)"}
    if item == "rotation":
        units = {180 / math.pi: "degrees", 1000.0: "milliseconds"}
    whole = max(slope, 1 / slope)
    likely = min(units, key=lambda factor: abs(math.log(factor / whole)))
    side = "poses" if slope > 1 else "controls or times"
    detail = (
        f"moves {slope:.3g} times as fast as is commanded: {side} likely in {units[likely]}; give "
        "metres, radians and seconds throughout"
    )
    yield "controls", Fault(Kind.CONTROL_UNIT, detail, item)


def _spin(rotation: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (T, 3) rates of rotation in the base frame of (T, 3, 3) rotations."""
    rate = np.gradient(rotation, times, axis=0) @ rotation.transpose(0, 2, 1)
    return np.stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0]], -1)


def _angular(
    angles: np.ndarray, times: np.ndarray, wanted: np.ndarray
) -> Iterator[tuple[str, Fault]]:
    """Hold the rotation of (3, T) angles, read in each way, against the rates commanded."""
    if math.sqrt(float((wanted**2).mean())) < 10 * _MOVING:
        return
    rotation = _matrices(angles)
    spins = {"as given": _spin(rotation, times)}
    spins["transposed (the inverse)"] = _spin(rotation.transpose(0, 2, 1), times)
    for name, turn in MIRRORED.items():
        spins[name] = _spin(_matrices(np.stack(turn(*angles))), times)
    for size in SCALED:  # the arcsine of an element is all that a factor changes
        lean = np.arcsin(np.sin(angles[1]) / size)
        spins[f"not unit, {size:g} times a rotation"] = _spin(
            _matrices(np.stack([angles[0], lean, angles[2]])), times
        )
    fits = {name: _cosine(_averaged(spin), wanted) for name, spin in spins.items()}
    given = fits.pop("as given")
    if given >= _FOLLOWS:
        yield from _slope(_averaged(spins["as given"]), wanted, "rotation")
    best = max(fits, key=lambda name: fits[name])
    left, other = 1 - given * abs(given), 1 - fits[best] * abs(fits[best])
    if fits[best] >= _EXPLAINS and left > max(_UNEXPLAINED, _BETTER * other):
        detail = (
            f"turns with the rates commanded if read as {best} (cosine {fits[best]:.2f}), not as "
            f"given ({given:.2f}); give the columns of R as the probe's axes in the right-handed "
            "base frame"
        )
        kind = {"transposed": Kind.TRANSPOSED, "not": Kind.NOT_ORTHONORMAL}.get(
            best.split()[0], Kind.REFLECTED
        )
        yield "controls", Fault(kind, detail, "rotation")
