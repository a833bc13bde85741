"""Where a baked heart lies in the base frame, and how deep the scanner looks to hold it.

A heart is baked in its own frame; its place is a rigid transform, in double precision, applied to
the samples of a probe. Contact and forces know the base frame alone.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import normalize

from racines_data.geometry import Pose, axis_angle_to_matrix
from racines_data.patients.form import Point, Shape, reach
from racines_data.patients.landmarks import landmarks, view_specs
from racines_data.patients.patient import Patient, Place
from racines_data.phantom.config import BlockConfig
from racines_data.phantom.heart import DOWN, HEADING, ORIGIN
from racines_data.phantom.truth import nominal_pose
from racines_data.world import Workspace

SURFACE = BlockConfig().maximum[2]
"""Height of the skin, m, base frame: that of the phantom's block."""
MIDDLE = 35.0  # height of the point that is placed, over the annulus, mm
REACH = (0.312, -0.138, 0.036), (0.686, 0.214, 0.134)
"""The workspace: where the placed hearts' windows are, and half a heart around them, m."""
TILT_MAX, YAW_MAX = 1.22, 3.0  # rad
BEYOND = 19.0  # of the deepest landmark that a view shows, to the sector's end, mm


@dataclass(frozen=True)
class Placement:
    """A heart in the base frame."""

    axes: Tensor
    """(3, 3) float64, rows are the organ's axes in the base frame."""
    origin: Tensor
    """(3,) float64, m."""

    def to_base(self, points: Tensor) -> Tensor:
        """Return (…, 3) points of the organ frame, mm, in the base frame, m."""
        return points * 1e-3 @ self.axes + self.origin


def place(shape: Shape, patient: Patient) -> Placement:
    """Lay a heart under the chest wall, turned and tilted."""
    return lay(partial(_top, shape), patient)


def lay(top_of: Callable[[Point], float], patient: Patient) -> Placement:
    """Lay a heart that reaches so far, mm from its origin, in a direction of its own frame."""
    axes = _upright() @ _rotation(patient.place).T
    up = axes[:, 2].tolist()
    top = top_of((up[0], up[1], up[2])) * 1e-3  # above the organ's origin
    height = SURFACE - patient.chest.thickness - patient.place.clearance - top
    middle = torch.tensor([0.0, 0.0, MIDDLE * 1e-3], dtype=torch.float64) @ axes
    x, y = ORIGIN[0] + patient.place.x, ORIGIN[1] + patient.place.y
    origin = torch.tensor([x - float(middle[0]), y - float(middle[1]), height], dtype=torch.float64)
    return Placement(axes, origin)


def _upright() -> Tensor:
    """Return the axes of an unturned heart: apex, front and right side face the skin."""
    down = normalize(torch.tensor(DOWN, dtype=torch.float64), dim=0)
    long_axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    forward = normalize(long_axis - (long_axis @ down) * down, dim=0)
    side = torch.linalg.cross(-down, forward)
    cos, sin = math.cos(HEADING), math.sin(HEADING)
    return torch.stack([cos * forward - sin * side, sin * forward + cos * side, -down], -1)


def _rotation(place: Place) -> Tensor:
    """Return the (3, 3) turn about the vertical, then the tilt about a level axis."""
    tilt = place.tilt * math.cos(place.tilt_way), place.tilt * math.sin(place.tilt_way), 0.0
    vectors = torch.tensor([tilt, (0.0, 0.0, place.turn)], dtype=torch.float64)
    tilted, turned = axis_angle_to_matrix(vectors)
    return tilted @ turned


def _top(shape: Shape, up: Point) -> float:
    """Return how far a heart reaches up, mm from its origin, walls and pericardium included."""
    tops = [reach(shape.lv_outer, up) + 1.5, reach(shape.right, up) + 5.5]
    for point, radius in zip(shape.outflow.path, shape.outflow.radii, strict=True):
        tops.append(sum(p * n for p, n in zip(point, up, strict=True)) + radius + 4.0)
    return max(tops)


def geometric_poses(shape: Shape, placement: Placement) -> Pose:
    """Return the (V,) poses that the views' planes give, float64: where a search begins."""
    poses = [
        nominal_pose(view, placement.axes, placement.origin, SURFACE) for view in view_specs(shape)
    ]
    return Pose(*(torch.stack(parts) for parts in zip(*poses, strict=True)))


def depth_to_hold(shape: Shape, placement: Placement, poses: Pose, margin: float) -> float:
    """Return the depth of the sector, m, at which every view has all that it shows."""
    marks = landmarks(shape)
    centres = torch.tensor([mark.centre for mark in marks], dtype=torch.float64)
    away = (placement.to_base(centres) - poses.position.unsqueeze(1)).norm(dim=-1)
    names = [mark.name for mark in marks]
    far = 0.0
    for row, view in zip(away, view_specs(shape), strict=True):
        far = max(far, *(float(row[names.index(name)]) for name, _ in view.structures))
    return round((far + BEYOND * 1e-3) * (1.0 + margin), 6)


def workspace(device: torch.device) -> Workspace:
    """Return where the probe may go."""
    lowest, highest = torch.tensor(REACH, device=device)
    return Workspace(lowest, highest, TILT_MAX, YAW_MAX)
