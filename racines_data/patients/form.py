# pyright: strict
"""From sizes to shape: where the parts of a patient's heart lie, in its own frame.

Organ frame, millimetres, as the phantom's: u towards the left ventricle's lateral wall, v anterior,
w from base to apex, the origin in the centre of the mitral annulus; `s` is the anteroseptal
direction in which a parasternal probe looks, `t` the normal of the parasternal long-axis plane. The
LV is an ellipsoid cut by the annulus; neighbours lie against the walls that they share with it, so
they move when it grows.
"""

import math
from dataclasses import dataclass

from racines_data.patients.patient import Form
from racines_data.phantom.heart import S, T

Point = tuple[float, float, float]
FOOT: Point = (-0.30, -0.55, 0.78)
"""Direction of the feet: from the parasternal window to the subcostal one."""
LIVER: Point = (-0.80, -0.40, 0.447214)
"""Normal of the diaphragm, into the liver."""


def along(s: float, t: float, w: float) -> Point:
    """Return the point with coordinates along s, t and w."""
    return (s * S[0] + t * T[0], s * S[1] + t * T[1], w)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid, along the organ's axes or turned about w."""

    centre: Point
    radii: Point
    turn: float = 0.0
    """Where its first axis points, from u, rad."""


@dataclass(frozen=True)
class Tube:
    """A tube along a polyline, one radius a vertex."""

    path: tuple[Point, ...]
    radii: tuple[float, ...]


@dataclass(frozen=True)
class Valve:
    """A ring in which leaflets hinge."""

    centre: Point
    radius: float
    longer: Point
    """Direction, in the ring's plane, from the centre to the hinge of the longer leaflet."""
    leaflets: tuple[float, float]
    """Lengths of the longer and the shorter leaflet."""


@dataclass(frozen=True)
class Shape:
    """A heart at end diastole, mm."""

    form: Form
    semi: float  # of the LV inside, mean of its two axes across
    middle: float  # height of the LV's widest place
    half: float  # semi-axis of the LV along w
    lv_outer: Ellipsoid
    left_atrium: Ellipsoid
    right_atrium: Ellipsoid
    right: Ellipsoid  # RV body, which the LV is cut out of
    outflow: Tube
    pulmonary: Tube
    aorta: Tube
    mitral: Valve
    tricuspid: Valve
    papillaries: tuple[Tube, Tube]
    moderator: Tube
    cava: Tube
    descending: Tube
    diaphragm: float  # distance of the liver from the origin along `LIVER`

    @property
    def root(self) -> float:
        """Distance of the aortic root from the LV's axis, along s."""
        x, y, _ = self.aorta.path[2]
        return x * S[0] + y * S[1]


def shape_of(form: Form) -> Shape:
    """Lay out a heart from its sizes."""
    semi, tall = form.ventricle / 2.0, form.length / 76.0
    wide = semi / 22.5
    septal = semi + form.septum  # the septum's right side
    left = _scaled((21.0, 19.0, 22.0), form.left_atrium / 38.0)
    right = _scaled((19.0, 22.0, 22.0), form.right_atrium / 38.0)
    body = 0.5 * septal + 0.6 * form.right
    wall, oval = (form.wall + form.septum) / 2.0, form.oval**0.5
    lv_outer = Ellipsoid(
        ((form.wall - form.septum) / 2.0, 0.0, 16.0 * tall),
        (semi / oval + wall, semi * oval + wall, 60.0 * tall + min(0.8 * form.wall, 11.0)),
        form.oval_turn,
    )
    aorta, outflow = _vessels(form, wide**0.4, tall)  # the base widens less than the middle
    last = outflow.path[-1]
    atrium = (-(left[0] + 3.0 + right[0]), -4.0 * wide, -(right[2] + 1.0))
    return Shape(
        form=form,
        semi=semi,
        middle=16.0 * tall,
        half=60.0 * tall,
        lv_outer=lv_outer,
        left_atrium=Ellipsoid((0.0, -10.0 * wide, -(left[2] + 3.0)), left),
        right_atrium=Ellipsoid(atrium, right),
        right=Ellipsoid(
            (-(septal + form.right - body), 8.0 * wide, 19.0 * tall),
            (body, body, 50.0 * tall * form.right_length),
        ),
        outflow=outflow,
        pulmonary=Tube((last, along(-4.0, 40.0, -34.0)), (outflow.radii[-1], 9.0)),
        aorta=aorta,
        mitral=Valve((1.0, -4.0 * wide, 1.0), 14.5 * wide, along(1.0, 0.0, 0.0),
                     (20.0 * wide, 12.5 * wide)),
        tricuspid=Valve((-(septal + 0.45 * form.right), 2.0, 5.0), 0.41 * form.right,
                        (-1.0, 0.0, 0.0), (0.52 * form.right, 0.36 * form.right)),
        papillaries=(_papillary(form, wide, tall, 1.0), _papillary(form, wide, tall, -1.0)),
        moderator=Tube(((-septal + 8.0, 8.0, 46.0 * tall),
                        (-septal - 0.45 * form.right, 6.0, 38.0 * tall)), (2.2, 2.8)),
        cava=_cava(atrium),
        descending=_descending(form, wide),
        diaphragm=_diaphragm(form, lv_outer, septal, body, tall),
    )  # fmt: skip


def _scaled(point: Point, size: float) -> Point:
    return (point[0] * size, point[1] * size, point[2] * size)


def _vessels(form: Form, wide: float, tall: float) -> tuple[Tube, Tube]:
    """Return aorta and RV outflow, which winds round the aortic root."""
    sinus = form.root / 2.0
    ring = 0.74 * sinus
    root = max(21.0 * wide, sinus + 5.0)
    aorta = Tube(
        (along(0.68 * root, 0.0, 8.0), along(0.87 * root, 0.0, -6.0), along(root, 1.0, -16.0),
         along(root + 1.0, -2.0, -32.0), along(root + 1.0, -4.0, -44.0)),
        (0.96 * ring, ring, sinus, 0.85 * sinus, 0.87 * sinus),
    )  # fmt: skip
    size = form.outflow / 22.0
    around = root + sinus + 1.5 + 12.0 * size
    outflow = Tube(
        (along(around - 16.0, -30.0 * wide, 30.0 * tall), along(around - 6.0, -16.0 * wide, 8.0),
         along(around, 2.0 * wide, -12.0), along(around - 12.0, 27.0 * wide, -20.0),
         along(around - 36.0, 38.0 * wide, -28.0)),
        (12.0 * size, 13.0 * size, 12.0 * size, 11.0 * size, 10.5 * size),
    )  # fmt: skip
    return aorta, outflow


def _papillary(form: Form, wide: float, tall: float, side: float) -> Tube:
    foot, tip = 13.5 * wide, 9.0 * wide
    return Tube(
        (along(-foot, side * foot, 48.0 * tall), along(-tip, side * tip, 27.0 * tall)),
        (5.0 * form.papillary * wide, 2.8 * form.papillary),
    )


def _cava(atrium: Point) -> Tube:
    """Return the inferior vena cava: from the right atrium towards the feet."""
    ends = tuple(
        (atrium[0] + d * FOOT[0], atrium[1] + d * FOOT[1] - 4.0, atrium[2] + d * FOOT[2])
        for d in (8.0, 52.0)
    )
    return Tube(ends, (9.5, 8.0))


def _descending(form: Form, wide: float) -> Tube:
    """Return the descending aorta, behind the left atrium and ventricle."""
    x, y, w = along(-(18.0 * wide + form.wall + 8.0), 4.5, -22.0)
    ends = tuple((x + d * FOOT[0], y + d * FOOT[1] * 0.5, w + d * FOOT[2]) for d in (-18.0, 18.0))
    return Tube(ends, (0.36 * form.root, 0.34 * form.root))


def _diaphragm(form: Form, lv: Ellipsoid, septal: float, body: float, tall: float) -> float:
    """Return where the liver begins, mm: it hugs the heart's lowest side."""
    right = Ellipsoid(
        (-(septal + form.right - body), 8.0 * form.ventricle / 45.0, 19.0 * tall),
        (body, body, 50.0 * tall * form.right_length),
    )
    return max(reach(lv, LIVER), reach(right, LIVER) + 4.0) - 7.0


def reach(shape: Ellipsoid, way: Point) -> float:
    """Return how far an ellipsoid reaches along a direction, from the origin."""
    middle = sum(c * n for c, n in zip(shape.centre, way, strict=True))
    cos, sin = math.cos(shape.turn), math.sin(shape.turn)
    way = (cos * way[0] + sin * way[1], cos * way[1] - sin * way[0], way[2])
    return middle + sum((r * n) ** 2 for r, n in zip(shape.radii, way, strict=True)) ** 0.5
