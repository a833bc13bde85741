# pyright: strict
"""Smooth unevenness of what is heard, anchored in the heart and moving with it.

    nodes of the polar grid, in the organ at end diastole -> waves and steps -> dB at the nodes

Real walls drop out in patches of centimetres, for the sound has come through uneven tissue and
meets muscle at changing angles. Lung and pericardium beside the left ventricle and behind the atria
throw back more than what lies before the apex. It is a matter of the picture alone: the oracle says
what the plane holds and the sound reaches, and does not ask how brightly it is heard.
"""

import math

import torch
from torch import Tensor

from racines_data.patients.form import Shape
from racines_data.patients.patient import Patient
from racines_data.patients.volume import LOW, VOXEL
from racines_data.randomness import derive, uniform

WAVES = 10
WAVELENGTHS = 40.0, 130.0
"""Of the waves, mm: long against the way from node to node, 8 to 16 mm."""
SIZE = 3.5, 11.0  # their root mean square from patient to patient, dB
BEHIND, SIDE, CAP = (-3.0, 9.0), (2.0, 9.0), (-8.0, 0.0)
"""What is heard more behind the atria, on the LV's side of the heart, and before its apex, dB."""
WIDTHS = 22.0, 100.0, 12.0  # over which these three begin, mm


def patches_of(patient: Patient, shape: Shape) -> list[Tensor]:
    """Return the (5, WAVES) waves and (5, 3) steps of one patient, as `unevenness` takes them."""
    atrium, ventricle = shape.left_atrium, shape.lv_outer
    roof = atrium.centre[2] - atrium.radii[2]
    apex = ventricle.centre[2] + ventricle.radii[2]
    draw = uniform(derive(torch.tensor([patient.seed]), 863), 4 * WAVES + 4, 1)[0].double()
    dice = [float(each) for each in draw[4 * WAVES :]]
    strength, rises = _between(SIZE, dice[0]), zip((BEHIND, SIDE, CAP), dice[1:], strict=True)
    rise = [_between(ends, share) for ends, share in rises]
    back, _, front = WIDTHS
    ways = draw.new_tensor([(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]).T
    start = draw.new_tensor([roof / back, 0.5, -apex / front])
    steps = _rows(ways / draw.new_tensor(WIDTHS), start, draw.new_tensor(rise))
    return [_waves(draw[: 4 * WAVES].view(4, WAVES), strength), steps]


def _between(ends: tuple[float, float], share: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * share


def _waves(draw: Tensor, size: float) -> Tensor:
    """Return plane waves in all directions, of (4, WAVES) uniform numbers and a size in dB."""
    length, level, turn, phase = draw
    short, long = WAVELENGTHS
    turns = 1.0 / (short * (long / short) ** length)
    height, around = 2.0 * level - 1.0, 2.0 * math.pi * turn
    ring = (1.0 - height.square()).sqrt()
    way = torch.stack([ring * around.cos(), ring * around.sin(), height])
    return _rows(way * turns, phase, torch.full_like(phase, size * (2.0 / WAVES) ** 0.5))


def _rows(way: Tensor, start: Tensor, size: Tensor) -> Tensor:
    """Join (3, N) changes a mm, (N,) values at the organ's origin and (N,) dB to (5, N).

    Changes and values are turned into those of a voxel and of the box's corner.
    """
    start = start + (way * way.new_tensor(LOW).unsqueeze(1)).sum(0)
    return torch.cat([way * way.new_tensor(VOXEL).unsqueeze(1), start[None], size[None]])


def unevenness(place: Tensor, waves: Tensor, steps: Tensor) -> Tensor:
    """Return (B, 13, 19) float32 dB by which echoes from the nodes of rows are raised.

    Args:
        place: (B, 3, 13, 19) float64, voxels of the box at end diastole.
        waves: (B, 5, N) changes a voxel along the box's axes, value at its corner, dB.
        steps: (B, 5, M) the same; each rises from 0 to 1.
    """
    place = place.unsqueeze(-1)
    field = torch.sin(2.0 * math.pi * _along(place, waves)) * waves[:, None, None, 4]
    share = _along(place, steps).clamp(0.0, 1.0)
    rise = share.square() * (3.0 - 2.0 * share) * steps[:, None, None, 4]
    return (field.sum(-1) + rise.sum(-1)).float()


def _along(place: Tensor, rows: Tensor) -> Tensor:
    """Return the (B, 13, 19, N) values that (B, 5, N) rows have at (B, 3, 13, 19, 1) places."""
    way = rows[:, :, None, None]
    value = way[:, 3] + place[:, 0] * way[:, 0]
    return value + place[:, 1] * way[:, 1] + place[:, 2] * way[:, 2]
