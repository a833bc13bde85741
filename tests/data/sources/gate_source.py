"""A source for tests of the gate: sound sweeps, or the same with one mistake.

Poses are smooth, controls are their velocities, contact pushes along -z of the probe, and images
are sectors of speckle with the tip at the top. It stands alone, as somebody's plug-in would.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch

from racines_data.config import fill
from racines_data.geometry import euler_to_matrix, matrix_to_euler
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, Unit
from racines_data.views import LABELS

RATE = 25.0
GRAM = 9.80665e-3
Columns = dict[str, np.ndarray]


def sector(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return (T, 128, 128) uint8 sectors of speckle."""
    y, x = np.mgrid[:128, :128] - np.array([0.0, 63.5])[:, None, None]
    inside = (np.hypot(y, x) < 126) & (np.abs(x) <= 3 + y * np.tan(np.radians(42)))
    return (rng.integers(20, 240, (count, 128, 128)) * inside).astype(np.uint8)


def rotations(columns: Columns) -> torch.Tensor:
    return euler_to_matrix(torch.from_numpy(columns["parameters"][:, 9:].astype(float)))


def from_matrices(columns: Columns, matrices: torch.Tensor) -> Columns:
    """Turn matrices into angles as a plug-in would that does not look at them."""
    parameters = columns["parameters"].copy()
    parameters[:, 9:] = matrix_to_euler(matrices).numpy()
    return columns | {"parameters": parameters}


def mirror(axis: int) -> torch.Tensor:
    return torch.diag(torch.tensor([-1.0 if i == axis else 1.0 for i in range(3)]).double())


def scaled(part: slice, factor: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        parameters = columns["parameters"].copy()
        parameters[:, part] *= factor
        return columns | {"parameters": parameters}

    return change


def timed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {"timestamps": change(columns["timestamps"])}


def drawn(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {"images": change(columns["images"])}


def halves(columns: Columns) -> Columns:
    """Positions in metres, then in millimetres."""
    parameters = columns["parameters"].copy()
    parameters[len(parameters) // 2 :, 6:9] *= 1000
    return columns | {"parameters": parameters}


def divided(columns: Columns) -> Columns:
    """Positions in metres, some of them divided once more as if they had been in millimetres."""
    parameters = columns["parameters"].copy()
    parameters[8:20, 6:9] /= 1000
    return columns | {"parameters": parameters}


def freeze(images: np.ndarray) -> np.ndarray:
    return np.repeat(images[:1], len(images), 0)


def freeze_a_third(images: np.ndarray) -> np.ndarray:
    frozen = images.copy()
    frozen[20:36] = frozen[20]
    return frozen


def stale(columns: Columns) -> Columns:
    parameters = columns["parameters"].copy()
    parameters[:, 6:] = parameters[0, 6:]
    return columns | {"parameters": parameters}


def swapped(columns: Columns) -> Columns:
    parameters = columns["parameters"].copy()
    parameters[:, 6:8] = parameters[:, [7, 6]]
    return columns | {"parameters": parameters}


POSITION, ANGLES, FORCE = slice(6, 9), slice(9, 12), slice(0, 3)
MISTAKES: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "mirrored in the probe": (
        lambda c: from_matrices(c, rotations(c) @ mirror(0)),
        "reflected rotation: rotation: .*mirrored along an axis of the probe",
    ),
    "mirrored in the base": (
        lambda c: from_matrices(c, mirror(1) @ rotations(c)),
        "reflected rotation: rotation: .*mirrored along y of the base",
    ),
    "mirrored beam": (
        lambda c: from_matrices(c, rotations(c) @ mirror(2)),
        "looks up: rotation: .*turn the frame",
    ),
    "transposed": (
        lambda c: from_matrices(c, rotations(c).transpose(1, 2)),
        "transposed rotation: rotation: .*columns of R",
    ),
    "left-handed": (scaled(slice(7, 8), -1.0), "reflected rotation: position: y moves against"),
    "swapped axes": (swapped, "reflected rotation: position: x moves as control_y"),
    "twice a rotation": (
        lambda c: from_matrices(c, 2.0 * rotations(c)),
        "non-orthonormal rotation: rotation: .*not unit, 2 times",
    ),
    "a thousand times a rotation": (
        lambda c: from_matrices(c, 1000.0 * rotations(c)),
        "non-orthonormal rotation: rotation_y: .*normalise",
    ),
    "degrees": (scaled(ANGLES, 180 / np.pi), "degrees: rotation_[xyz]: .*multiply by π/180"),
    "millimetres": (scaled(POSITION, 1e3), "millimetres: position: .*likely mm, multiply by 0.001"),
    "centimetres": (scaled(POSITION, 1e2), "centimetres: position: .*likely cm, multiply by 0.01"),
    "mixed frames": (halves, "millimetres: position: .*units are mixed within it"),
    "divided twice": (divided, "mixed units: position: frame 8 lies .*give metres throughout"),
    "backwards": (timed(lambda t: t[::-1].copy()), "clock: timestamp: runs backwards"),
    "milliseconds": (timed(lambda t: t * 1e3), "clock: timestamp: .*likely milliseconds"),
    "repeated": (
        timed(lambda t: np.repeat(t[::2], 2)),
        "clock: timestamp: 20 frames repeat the time before",
    ),
    "one time back": (
        timed(lambda t: np.concatenate([t[:9], t[8:9] - 1.0, t[10:]])),
        "clock: timestamp: decreases at frame 9",
    ),
    "0-1": (
        drawn(lambda images: (images > 120).astype(np.uint8)),
        "range of gray: image: .*likely 0-1",
    ),
    "0-1 floats": (
        drawn(lambda images: images / np.float32(255)),
        "range of gray: image: .*float32.*multiply by 255",
    ),
    "constant": (drawn(lambda images: np.full_like(images, 77)), "constant image: image: "),
    "frozen": (drawn(freeze), "frozen: image: 39 of 40 frames repeat"),
    "frozen for a while": (drawn(freeze_a_third), "frozen: image: frames 20 to 35 are one image"),
    "inverted": (drawn(lambda images: 255 - images), "range of gray: image: .*likely inverted"),
    "upside down": (drawn(lambda images: images[:, ::-1]), "turned image: .*tip is at the bottom"),
    "rows for columns": (
        drawn(lambda images: images.swapaxes(1, 2)),
        "turned image: .*tip is at the left",
    ),
    "grams": (scaled(FORCE, 1 / GRAM), "unit of force: force: .*likely grams-force"),
    "action for reaction": (scaled(FORCE, -1.0), "sign of force: force_z: .*change its sign"),
    "stale pose": (stale, "frozen: pose: .*give each frame the pose"),
    "velocity in mm/s": (
        lambda c: c | {"controls": c["controls"] * np.array([1e3] * 3 + [1] * 3, np.float32)},
        "unit of velocity: ",
    ),
}
"""What is done to sound columns, and what the refusal has to say."""


@dataclass(frozen=True)
class ScansConfig:
    mistake: str = ""
    only: int = -1
    """Number of the one trajectory that has the mistake; all, if negative."""


@dataclass
class Scans:
    config: ScansConfig = ScansConfig()
    report: list[Finding] = field(default_factory=list)
    name = "scans"
    version = "0.1.0"
    Config = ScansConfig

    @classmethod
    def from_config(cls, config, inputs=()):
        return cls(fill(ScansConfig, config, "data.scans"))

    def recipe(self):
        return {**vars(self.config)}

    def plan(self):
        return [Unit(f"t{i}", "s1", LABELS[i % 6], 40) for i in range(3)]

    def produce(self, unit):
        number = int(unit.id[1:])
        columns = sound(number, unit.frames)
        if self.config.mistake and self.config.only in (-1, number):
            columns = MISTAKES[self.config.mistake][0](columns)
        return made(unit, columns)


def made(unit: Unit, columns: Columns) -> Trajectory:
    n = unit.frames
    views, grades = np.full(n, -1), np.full(n, np.nan, np.float32)
    return Trajectory(
        unit.id, unit.session, unit.target_view, **columns, views=views, grades=grades
    )


def sound(number: int, count: int = 40) -> Columns:
    """Return the columns of a sound sweep of `count` frames, the controls its velocities."""
    rng = np.random.default_rng(number)
    times = np.arange(count) / RATE
    phase = rng.uniform(0, 2 * np.pi, 6)
    path = np.sin(2 * np.pi * times[:, None] * np.linspace(0.5, 0.9, 6) + phase)
    position = np.array([0.49, 0.21, 0.06]) + path[:, :3] * [0.03, 0.03, 0.02]
    angles = np.array([2.5, 0.1, 0.4]) + path[:, 3:] * [0.3, 0.35, 0.4]
    rotation = euler_to_matrix(torch.from_numpy(angles)).numpy()
    turning = np.gradient(rotation, times, axis=0) @ rotation.transpose(0, 2, 1)
    spin = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], -1)
    speed = np.gradient(position, times, axis=0)
    force = rng.normal(0, 1, (count, 3)) + [0.0, 0.0, -9.0]
    torque = rng.normal(0, 0.2, (count, 3))
    return {
        "images": sector(rng, count),
        "parameters": np.hstack([force, torque, position, angles]).astype(np.float32),
        "timestamps": times,
        "controls": np.hstack([speed, spin]).astype(np.float32),
    }
