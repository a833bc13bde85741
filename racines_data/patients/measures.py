"""What is true of a patient's heart over the beat: volumes, ejection fraction, lengths, diameters.

Volumes are counted in the simulated geometry: a lattice of points in the beating heart, each asked
where it was at end diastole and what is there. So they hold all that is drawn, papillary muscles
and the walls' unevenness included, and not what a formula meant to do. Lengths and diameters are
those of the structures met along a line.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.patients.bake import label_box
from racines_data.patients.form import Point
from racines_data.patients.heart import Heart
from racines_data.patients.labels import (
    AORTA,
    AORTIC,
    CODES,
    LA,
    LV,
    MITRAL,
    MYOCARDIUM,
    PAPILLARY,
    RA,
    RV,
    RV_WALL,
    TRICUSPID,
    shown,
)
from racines_data.patients.motion import Dynamics, activation, to_diastole
from racines_data.patients.placement import MIDDLE
from racines_data.patients.volume import BOX, LOW, VOXEL, to_voxels
from racines_data.phantom.heart import T

PHASES = 10
"""Phases of the beat at which volumes are told, evenly from end diastole; end systole is added."""
LATTICE = 2.4  # mm
STEP = 0.1  # mm, between the points of a line
REACH = 120.0  # mm, of a line to either side
LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of contraction, at which volumes are counted; between them they are interpolated."""
PARTS = {
    "lv": (LV, PAPILLARY, MITRAL),  # as clinicians trace it: papillaries and leaflets in the cavity
    "myocardium": (MYOCARDIUM,),
    "la": (LA,),
    "rv": (RV, TRICUSPID),
    "rv_wall": (RV_WALL,),
    "ra": (RA,),
}
"""Labels of the parts whose volumes are told."""
LabelOf = Callable[[Tensor], Tensor]
"""From (M, 3) points of the organ frame, mm, to (M,) labels."""


@dataclass(frozen=True)
class Measures:
    """True figures of one patient; volumes in ml, lengths in mm."""

    phases: tuple[float, ...]
    """Cardiac phases of the volumes; the last is end systole."""
    volumes: dict[str, tuple[float, ...]]
    """Of lv, myocardium, la, rv, rv_wall and ra, at each of the phases."""
    ejection_fraction: float
    """Share of the LV's end-diastolic volume."""
    right_ejection_fraction: float
    lv_diameter: tuple[float, float]
    """Across the LV in the parasternal long axis, at end diastole and end systole."""
    lv_length: tuple[float, float]
    """From annulus to apex, inside."""
    wall: tuple[float, float]
    """Thickness of the posterior wall."""
    septum: tuple[float, float]
    """Thickness of the septum."""
    left_atrium: float
    """From front to back at end diastole."""
    root: float
    """Across the aortic sinuses, in the plane of the parasternal long axis."""
    right: float
    """Across the RV's base, from the septum to the free wall, at end diastole."""

    @property
    def shortening(self) -> float:
        """Descent of the base towards the apex, mm."""
        return self.lv_length[0] - self.lv_length[1]


def measure(heart: Heart) -> Measures:
    """Measure a heart."""
    phases = [i / PHASES for i in range(PHASES)]
    kick = heart.dynamics.kick
    levels = [float(activation(torch.tensor([p], dtype=torch.float64), kick)) for p in phases]
    labels = torch.tensor([shown(code, (0, 0, 0)) for code in range(CODES)], dtype=torch.uint8)
    box = labels[label_box(heart.shape).long()]
    counted = [volumes(box, heart.dynamics, level) for level in LEVELS]
    parts = {
        name: tuple(float(x) for x in np.interp([*levels, 1.0], LEVELS, [c[name] for c in counted]))
        for name in PARTS
    }
    first, last = (_at_level(box, heart, level) for level in (0.0, 1.0))
    shape = heart.shape
    return Measures(
        phases=(*phases, 0.375),
        volumes=parts,
        ejection_fraction=1.0 - parts["lv"][-1] / parts["lv"][0],
        right_ejection_fraction=1.0 - parts["rv"][-1] / parts["rv"][0],
        lv_diameter=(first.diameter, last.diameter),
        lv_length=(first.length, last.length),
        wall=(first.wall, last.wall),
        septum=(first.septum, last.septum),
        left_atrium=first.across(shape.left_atrium.centre, (0.0, 1.0, 0.0), (LA,)),
        root=first.across(shape.aorta.path[2], _across_root(shape.aorta.path), (AORTA, AORTIC)),
        right=first.across(shape.right.centre, (1.0, 0.0, 0.0), PARTS["rv"]),
    )


def volumes(box: Tensor, dynamics: Dynamics, level: float) -> dict[str, float]:
    """Count the volumes of parts, ml, at a level of contraction; `box` holds labels."""
    return count_volumes(lambda points: _labels(points, box, dynamics, level))


def count_volumes(label_of: LabelOf) -> dict[str, float]:
    """Count the volumes of parts, ml, in a heart."""
    sides = [torch.arange(low, low + BOX * size, LATTICE, dtype=torch.float64)
             for low, size in zip(LOW, VOXEL, strict=True)]  # fmt: skip
    # A lattice that no voxel's edge runs along: it is turned by its own coordinates' shares.
    points = torch.cartesian_prod(*sides) + 0.37 * LATTICE
    found = torch.cat([label_of(part) for part in points.split(1 << 17)])
    counts = torch.bincount(found.long(), minlength=AORTIC + 1)
    cell = LATTICE**3 / 1000.0
    return {name: float(sum(counts[i] for i in own)) * cell for name, own in PARTS.items()}


def _at_level(box: Tensor, heart: Heart, level: float) -> "_Ruler":
    return _Ruler(lambda points: _labels(points, box, heart.dynamics, level))


class _Ruler:
    """What lines through a heart measure, mm."""

    def __init__(self, label_of: LabelOf) -> None:
        self._label_of = label_of
        self.diameter, self.wall, self.septum = calipers(label_of)

    @property
    def length(self) -> float:
        """From annulus to apex, inside, along the LV's axis."""
        return self.across((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), PARTS["lv"])

    def across(self, centre: Point, way: Point, own: tuple[int, ...]) -> float:
        """Measure from the first to the last of a line's points that have one of the labels."""
        out = torch.arange(-REACH, REACH, STEP, dtype=torch.float64)
        start, along = (torch.tensor(each, dtype=torch.float64) for each in (centre, way))
        hit = torch.isin(self._label_of(start + out.unsqueeze(1) * along), torch.tensor(own))
        met = hit.nonzero().squeeze(1)
        if not len(met):
            raise RacinesError(f"a heart has none of the labels {own} on a line through {centre}")
        return round(STEP * float(met[-1] - met[0] + 1), 6)


def _across_root(path: tuple[Point, ...]) -> Point:
    """Return the direction across the sinuses: square to the root, in the long axis' plane."""
    along = np.subtract(path[3], path[1])
    across = np.cross(along, (T[0], T[1], 0.0))
    x, y, z = across / np.linalg.norm(across)
    return float(x), float(y), float(z)


def _labels(points: Tensor, box: Tensor, dynamics: Dynamics, level: float) -> Tensor:
    """Return the labels of (M, 3) points of a contracted heart, organ frame, mm."""
    act = torch.tensor([level], dtype=torch.float64)
    return labels_at(to_diastole(points.unsqueeze(0), dynamics, act)[0], box)


def labels_at(points: Tensor, box: Tensor) -> Tensor:
    """Return the labels of (M, 3) points at end diastole, organ frame, mm."""
    index = to_voxels(points).floor().long()
    inside = ((index >= 0) & (index < BOX)).all(1)
    index = index.clamp(0, BOX - 1)
    return box[tuple(index.unbind(1))] * inside


def calipers(label_of: LabelOf) -> tuple[float, float, float]:
    """Measure LV, posterior wall and septum across the LV's axis at its middle, mm."""
    height = MIDDLE - 8.0
    out = torch.arange(0.0, 75.0, 0.1, dtype=torch.float64)
    found: list[tuple[float, float]] = []
    for way in ((0.5, -0.8660254), (-0.5, 0.8660254), (-1.0, 0.0)):
        points = torch.stack([out * way[0], out * way[1], torch.full_like(out, height)], 1)
        label = label_of(points)
        wall = label == MYOCARDIUM
        start = int(wall.int().argmax())
        found.append((start * 0.1, float(wall.sum()) * 0.1))
    return found[0][0] + found[1][0], found[0][1], found[2][1]
