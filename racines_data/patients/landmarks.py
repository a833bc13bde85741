# pyright: strict
"""Where the named structures of a heart are, and the planes of its standard views.

All follow the shape: a wider ventricle moves its walls and all that lies against them. A landmark
names the labels that are found around it; a test holds it against the voxels.
"""

import math
from dataclasses import dataclass

from racines_data.patients.form import Point, Shape, along
from racines_data.patients.labels import (
    AORTA,
    LA,
    LV,
    MITRAL,
    MYOCARDIUM,
    PULMONARY,
    RA,
    RV,
    TRICUSPID,
)
from racines_data.phantom.anatomy import ViewSpec
from racines_data.phantom.heart import S, T, W

MM = 1e-3


@dataclass(frozen=True)
class Landmark:
    """A named place in a heart at end diastole."""

    name: str
    centre: Point
    """Organ frame, mm."""
    radius: float
    """Distance from the image plane at which it is all but lost, mm."""
    labels: tuple[int, ...]
    """What is found there."""


def landmarks(shape: Shape) -> tuple[Landmark, ...]:
    """Return the landmarks of a heart, in an order that all hearts share."""
    form, tall, wide = shape.form, shape.form.length / 76.0, shape.semi / 22.5
    septal, lateral = shape.semi + 0.5 * form.septum, shape.semi + 0.5 * form.wall
    beside = shape.semi + form.septum + 0.43 * form.right
    la, ra = shape.left_atrium.centre, shape.right_atrium.centre
    way = shape.outflow.path
    ring = 20.0 * wide
    rows = (
        ("LV apex", (0.0, 0.0, form.length - 4.0), 14.0, (LV,)),
        ("LV", (0.0, 0.0, 30.0 * tall), 16.0, (LV,)),
        ("LV lateral wall", (lateral, 0.0, 20.0 * tall), 16.0, (MYOCARDIUM,)),
        ("septum", (-septal, 0.0, 25.0 * tall), 16.0, (MYOCARDIUM,)),
        ("RV", (-beside, 2.0, 16.0 * tall), 18.0, (RV,)),
        ("LA", la, 18.0, (LA,)),
        ("RA", ra, 18.0, (RA,)),
        ("crux", (-septal + 1.0, -4.0, -1.0), 14.0, (MYOCARDIUM,)),
        ("aortic root", shape.aorta.path[2], 15.5, (AORTA,)),
        ("aortic outflow", along(0.72 * shape.root, 0.0, 4.0), 11.0, (LV,)),
        ("anteroseptum", along(shape.semi + 0.25 * (form.wall + form.septum), 0.0, 24.0 * tall),
         12.0, (MYOCARDIUM,)),
        ("posterior wall", along(-lateral, 0.0, 20.0 * tall), 14.0, (MYOCARDIUM,)),
        ("RVOT", way[2], 15.0, (RV,)),
        ("RV outflow", _between(way[1], way[2], 0.6), 16.0, (RV,)),
        ("pulmonary trunk", _between(way[3], way[4], 0.25), 15.0, (PULMONARY,)),
        ("LA below root", (2.0, la[1] + 1.0, -20.0), 16.0, (LA,)),
        ("RA beside root", (ra[0] + 1.0, ra[1] + 1.0, -18.0), 18.0, (RA,)),
        ("mitral annulus anterior", along(8.0 * wide, 0.0, 4.0), 18.0, (LV, MITRAL)),
        ("mitral annulus posterior", along(-ring, 0.0, 4.0), 18.0, (LV, MITRAL, MYOCARDIUM)),
        ("mitral annulus lateral", along(-4.0 * wide, ring, 4.0), 18.0, (LV, MITRAL, MYOCARDIUM)),
        ("mitral annulus septal", along(-4.0 * wide, -ring, 4.0), 18.0, (LV, MITRAL, MYOCARDIUM)),
        ("RV base", (-beside - 1.0, 6.0, 9.0), 16.0, (RV, TRICUSPID)),
    )  # fmt: skip
    return tuple(Landmark(*row) for row in rows)


def _between(a: Point, b: Point, share: float) -> Point:
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z


_FOUR = (("LV", 1.5), ("LV apex", 1.0), ("septum", 1.0), ("LV lateral wall", 1.0), ("RV", 1.0),
         ("LA", 1.0), ("RA", 1.0), ("crux", 1.0))  # fmt: skip
_FOUR_NORMAL = (0.0, -1.0, 0.05)
_LONG = (("LV", 1.0), ("anteroseptum", 1.0), ("posterior wall", 1.0), ("aortic root", 1.5),
         ("aortic outflow", 1.0), ("LA below root", 1.0), ("RV outflow", 0.5))  # fmt: skip
_ROOT = (("aortic root", 2.0), ("RVOT", 1.0), ("pulmonary trunk", 1.0), ("LA below root", 1.0),
         ("RA beside root", 1.0))  # fmt: skip
_RING = (("mitral annulus anterior", 1.0), ("mitral annulus posterior", 1.0),
         ("mitral annulus lateral", 1.0), ("mitral annulus septal", 1.0),
         ("RV base", 1.0))  # fmt: skip


def view_specs(shape: Shape) -> tuple[ViewSpec, ...]:
    """Return the views in label order, as `racines_data.views.VIEWS`; metres."""
    tall, wide = shape.form.length / 76.0, shape.semi / 22.5
    septal = (-S[0], -S[1], 0.0)
    side = (1.0, 0.0, 0.0)
    short = (0.6, -0.8, 0.0)
    middle = -0.4 * shape.semi

    def metres(x: float, y: float, z: float) -> Point:
        return (x * MM, y * MM, z * MM)

    return (
        ViewSpec("A4C", metres(middle, -1.5, 20.0 * tall), _in_plane(side, 5.0), _FOUR_NORMAL,
                 _FOUR),
        ViewSpec("SC", metres(middle - 1.0, -1.5, 22.0 * tall), _in_plane(side, 57.0),
                 _FOUR_NORMAL, (("LV", 1.5), *_FOUR[2:])),
        ViewSpec("PL", metres(*along(2.0, 0.0, 8.0)), _in_plane(septal, 68.0), T, _LONG),
        ViewSpec("PSAV", metres(*along(0.67 * shape.root, 0.0, -16.0)), short, W, _ROOT),
        ViewSpec("PSMV", metres(*along(-4.0 * wide, 0.0, 6.0)), short, W, _RING),
    )  # fmt: skip


def _in_plane(first: Point, degrees: float) -> Point:
    """Rotate from -w (apical) towards `first` by an angle: a beam of a long-axis plane."""
    sin, cos = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    return (sin * first[0], sin * first[1], sin * first[2] - cos)
