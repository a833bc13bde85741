"""The leaflets: where they are in each stage of their valve's opening.

Mitral and tricuspid leaflets are sheets that hinge in their ring and swing towards the apex; the
aortic valve's three cusps meet in a star when closed and leave a triangle when open.
"""

import math

import torch
from torch import Tensor

from racines_data.patients.form import Shape, Valve
from racines_data.patients.labels import AORTIC, MITRAL, STAGES, TRICUSPID, valve_code

THICK = 0.95  # half of a leaflet's thickness, mm; thinner ones fall between voxels
SWING = (0.36, 0.64, 0.98, 1.30)
"""Angle between a leaflet and its ring in each stage, rad."""
APART = (0.0, 0.30, 0.62, 0.90)
"""How far the cusps' free edges have gone to the wall in each stage."""
CUSP = 0.85  # height of a cusp, against the radius of the root
MET = 0.5  # share of that height from which closed cusps meet


def leaflets(points: Tensor, shape: Shape) -> Tensor:
    """Return the (M,) uint8 valve codes of (M, 3) float64 points, mm; 0 where no leaflet is."""
    code = torch.zeros(len(points), dtype=torch.uint8, device=points.device)
    parts = (
        (MITRAL, lambda stage: _swinging(points, shape.mitral, stage)),
        (TRICUSPID, lambda stage: _swinging(points, shape.tricuspid, stage)),
        (AORTIC, lambda stage: _cusps(points, shape, stage)),
    )
    for valve, sheet in parts:
        stages = torch.zeros_like(code)
        for stage in range(STAGES):
            stages |= sheet(stage).to(torch.uint8) << stage
        code = torch.where(stages > 0, stages + (valve_code(valve, 1) - 1), code)
    return code


def _swinging(points: Tensor, valve: Valve, stage: int) -> Tensor:
    """Return where the two leaflets of a valve are: sheets from the ring, shorter at its ends."""
    offset = points - points.new_tensor(valve.centre)
    way = points.new_tensor(valve.longer)
    side = torch.linalg.cross(points.new_tensor((0.0, 0.0, 1.0)), way)
    forth, aside, up = offset @ way, offset @ side, offset[:, 2]
    share = (1.0 - (aside / valve.radius).square()).clamp_min(0.0).sqrt()
    hinge = valve.radius * share
    found = torch.zeros_like(up, dtype=torch.bool)
    cos, sin = math.cos(SWING[stage]), math.sin(SWING[stage])
    for sign, length in zip((1.0, -1.0), valve.leaflets, strict=True):
        inward = hinge - sign * forth
        out = inward * cos + up * sin
        # An open leaflet bends back to the wall at its tip, a closed one bellies to the atrium.
        bend = 0.006 * out.square() * (1.0 if stage else -0.6)
        off = (up * cos - inward * sin + bend).abs()
        found |= (off < THICK) & (out > -1.0) & (out < length * share.sqrt()) & (share > 0.25)
    return found


def _cusps(points: Tensor, shape: Shape, stage: int) -> Tensor:
    """Return where the aortic cusps are."""
    (low, high), radius = shape.aorta.path[1:3], shape.aorta.radii[1]
    start = points.new_tensor(low)
    axis = torch.nn.functional.normalize(points.new_tensor(high) - start, dim=0)
    first = torch.linalg.cross(axis, points.new_tensor((0.35, 0.2, 0.9)))
    first = torch.nn.functional.normalize(first, dim=0)
    second = torch.linalg.cross(axis, first)
    offset = points - start
    height = offset @ axis
    x, y = offset @ first, offset @ second
    out, tall = (x * x + y * y).sqrt(), CUSP * radius
    third = 2.0 * math.pi / 3.0
    turn = torch.remainder(torch.atan2(y, x), third) - third / 2.0  # from a cusp's middle
    wide = torch.lerp(out.new_tensor(radius), out.new_tensor(shape.aorta.radii[2]), 0.5)
    edge = (APART[stage] * 0.5 / turn.cos()).clamp_max(1.0) * wide  # a triangle when open
    reach = tall if stage else MET * tall
    climb = (height / reach).clamp(0.0, 1.0)
    belly = wide + (edge - wide) * climb.sqrt()
    sheet = ((out - belly).abs() < 1.1 * THICK) & (height > 0.0) & (height < reach)
    if stage == 0:  # closed: above their bellies the edges lie against each other in a star
        seam = out * (third / 2.0 - turn.abs()).sin()
        met = (height > MET * tall) & (height < 1.4 * tall)
        sheet |= (seam.abs() < THICK) & (out < wide) & met
    return sheet
