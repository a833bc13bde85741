# pyright: strict
"""Paint a heart: which label each point of its frame has, at end diastole.

Points are double: whether a point lies inside must not hang on the last bit of a processor.
"""

import math

import torch
from torch import Tensor

from racines_data.patients.form import Ellipsoid, Point, Shape, Tube
from racines_data.patients.labels import (
    AORTA,
    ATRIAL_WALL,
    BACKGROUND,
    CAVA,
    DESCENDING,
    LA,
    LV,
    MYOCARDIUM,
    PAPILLARY,
    PERICARDIUM,
    PULMONARY,
    RA,
    RV,
    RV_WALL,
    VESSEL_WALL,
)
from racines_data.phantom.heart import T
from racines_data.phantom.shapes import smooth_union, subtract, union

Points = tuple[Tensor, ...]
"""Three (M,) coordinates, mm: whole columns are read faster than rows of three."""
RIGHT_WALL, ATRIAL, VESSEL, SAC = 3.6, 2.4, 2.2, 1.5
"""Thickness of the RV's free wall, the atria's and vessels' walls and the pericardium, mm."""
TRICUSPID_PLANE = 5.0  # mm: the tricuspid valve stands nearer to the apex than the mitral


def paint(where: Tensor, shape: Shape) -> Tensor:
    """Return the (M,) uint8 labels at (M, 3) float64 points, mm; leaflets are not among them."""
    points = tuple(each.contiguous() for each in where.unbind(1))
    w = points[2]
    cavity = torch.maximum(_ventricle(points, shape), -w)
    outer = torch.maximum(_ellipsoid(points, shape.lv_outer), -w - 4.0)
    la, ra = _ellipsoid(points, shape.left_atrium), _ellipsoid(points, shape.right_atrium)
    aorta, outflow = _tube(points, shape.aorta), _tube(points, shape.outflow)
    body = torch.maximum(_ellipsoid(points, shape.right), -w + 1.0)
    right = smooth_union(body, outflow, 6.0)
    pulmonary = _tube(points, shape.pulmonary)
    rv = subtract(subtract(right, outer), aorta - 2.5)
    mitral = _ring(points, shape.mitral.centre, shape.mitral.radius, 12.0)
    tricuspid = _ring(points, shape.tricuspid.centre, shape.tricuspid.radius, 16.0)
    cava, descending = _tube(points, shape.cava), _tube(points, shape.descending)

    atria = union(la, ra)
    muscle = union(outer, subtract(right, outer) - RIGHT_WALL)
    vessels = union(aorta - VESSEL, pulmonary - 2.0, outflow - 2.5, cava - 1.5, descending - 2.0)
    whole = union(muscle, atria - ATRIAL, vessels)
    label = torch.full_like(w, BACKGROUND, dtype=torch.uint8)
    label[union(muscle, atria - ATRIAL, outflow - 2.5) < SAC] = PERICARDIUM
    label[whole < 0.0] = VESSEL_WALL
    label[atria - ATRIAL < 0.0] = ATRIAL_WALL
    label[right - RIGHT_WALL < 0.0] = RV_WALL
    label[outer < 0.0] = MYOCARDIUM
    label[(aorta - VESSEL < 0.0) & (w < 2.0)] = VESSEL_WALL
    label[cava < 0.0], label[descending < 0.0] = CAVA, DESCENDING
    label[torch.minimum(ra, tricuspid) < 0.0] = RA
    label[torch.minimum(la, mitral) < 0.0] = LA
    label[(torch.minimum(rv, tricuspid) < 0.0) & ((w > TRICUSPID_PLANE) | (rv < 0.0))] = RV
    across = points[0] * T[0] + points[1] * T[1]
    label[pulmonary < 0.0] = PULMONARY
    label[(label == RV) & (across > shape.outflow.path[3][0] * T[0] + shape.outflow.path[3][1]
                           * T[1])] = PULMONARY  # fmt: skip
    label[_tube(points, shape.moderator) < 0.0] = RV_WALL
    label[(torch.minimum(cavity, mitral) < 0.0) & (w >= 0.0)] = LV
    label[(union(*(_tube(points, each) for each in shape.papillaries)) < 0.0) & (cavity < 0.0)] = (
        PAPILLARY
    )
    label[(aorta < 0.0) & (w < -4.0)] = AORTA
    label[(aorta < 0.0) & (w >= -4.0)] = LV  # the outflow tract
    _partition(label, la, ra, aorta, torch.minimum(mitral, tricuspid))
    return label


def _partition(label: Tensor, la: Tensor, ra: Tensor, aorta: Tensor, valves: Tensor) -> None:
    """Keep atria and aortic root apart by their walls, in place."""
    atria = union(la, ra)
    between = torch.maximum(atria, (la - ra).abs() / 2 - ATRIAL / 2) < 0.0
    around = torch.maximum(atria, aorta - 2.5) < 0.0
    label[between & (valves > 0.0) & (aorta > 0.0)] = ATRIAL_WALL
    label[around & (valves > 0.0) & (aorta > 0.0)] = VESSEL_WALL


def _ventricle(points: Points, shape: Shape) -> Tensor:
    """Return the distance of points to the LV's endocardium, an oval that waves a little."""
    turn, oval = shape.form.oval_turn, shape.form.oval**0.5
    u, v, w = points
    radii = (shape.semi / oval, shape.semi * oval, shape.half)
    smooth = _ellipsoid(points, Ellipsoid((0.0, 0.0, shape.middle), radii, turn))
    angle = torch.atan2(v, u)
    wave = torch.cos(3.0 * angle + 2.0 * turn) + torch.cos(5.0 * angle - w / 6.0)
    return smooth + shape.form.waviness * shape.semi * wave


def _ring(points: Points, centre: Point, radius: float, below: float) -> Tensor:
    """Return the distance to the opening of a valve between atrium and ventricle."""
    u, v, w = centre
    return _capsule(points, (u, v, w + 3.0), (u, v - 3.0, w - below), radius, 0.97 * radius)


def _ellipsoid(points: Points, shape: Ellipsoid) -> Tensor:
    """Return the distance to an ellipsoid; see `phantom.shapes.ellipsoid`."""
    u, v, w = (x - centre for x, centre in zip(points, shape.centre, strict=True))
    if shape.turn:
        cos, sin = math.cos(shape.turn), math.sin(shape.turn)
        u, v = cos * u + sin * v, cos * v - sin * u
    first = second = torch.zeros_like(w)
    for x, radius in zip((u, v, w), shape.radii, strict=True):
        square = (x / radius).square()
        first, second = first + square, second + square / radius**2
    return first.sqrt() * (first.sqrt() - 1.0) / second.sqrt().clamp_min(1e-9)


def _tube(points: Points, shape: Tube) -> Tensor:
    """Return the distance to a tube along a polyline, one radius a vertex."""
    ends = zip(shape.path, shape.path[1:], shape.radii, shape.radii[1:], strict=False)
    return union(*(_capsule(points, *each) for each in ends))


def _capsule(points: Points, a: Point, b: Point, radius_a: float, radius_b: float) -> Tensor:
    """Return the distance to a rounded cone from a to b."""
    way = [end - start for start, end in zip(a, b, strict=True)]
    offset = [x - start for x, start in zip(points, a, strict=True)]
    share = offset[0] * way[0] + offset[1] * way[1] + offset[2] * way[2]
    share = (share / sum(part * part for part in way)).clamp(0.0, 1.0)
    square = [(x - share * part).square() for x, part in zip(offset, way, strict=True)]
    return (square[0] + square[1] + square[2]).sqrt() - (radius_a + share * (radius_b - radius_a))
