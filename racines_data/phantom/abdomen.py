"""The right upper abdomen in the block: right kidney, liver and gallbladder, of a still adult.

Organ frame, metres: u caudal, v to the patient's left, w anterior; the origin is the middle of the
block's top. Longitudinal pictures have the head end on the left, transverse ones the patient's
right.

Sizes are those of normal adults. Kidney: length 90-120 mm (right, median 109 mm), width 40-60 mm,
volume about 134 ml (Emamian et al., Kidney dimensions at sonography, AJR 1993); parenchyma 15-20 mm
of which cortex 7-10 mm (Hansen et al., Ultrasonography of the Kidney: A Pictorial Review,
Diagnostics 2016). Gallbladder: under 100 mm by 40 mm, wall under 3 mm (Rumack & Levine, Diagnostic
Ultrasound). Speed, density and attenuation are from Duck, Physical Properties of Tissue (1990) and
Mast, Empirical relationships between acoustic parameters in human soft tissues (ARLO 2000). The
echogenicities keep the order that sonographers know: sinus > liver >= cortex > pyramids > bile.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from racines_data.phantom.anatomy import Anatomy, Point, Structure, Tissue, ViewSpec, to_point
from racines_data.phantom.shapes import capsule, ellipsoid, smooth_union, subtract, tube, union
from racines_data.randomness import sample_seeds, uniform

TISSUES = (
    Tissue("gel", -15.0, 0.50, 1540.0, 1040.0, 1.0),
    Tissue("liver", -3.0, 0.50, 1595.0, 1060.0, 1.2),
    Tissue("renal cortex", -7.0, 0.60, 1560.0, 1050.0, 1.0),
    Tissue("renal pyramid", -17.0, 0.60, 1560.0, 1045.0),
    Tissue("renal sinus", 5.0, 0.60, 1500.0, 990.0, 2.0),
    Tissue("capsule", 4.0, 0.80, 1613.0, 1100.0),
    Tissue("diaphragm", 8.0, 1.50, 1613.0, 1120.0),
    Tissue("blood", -34.0, 0.20, 1584.0, 1060.0),
    Tissue("vessel wall", 2.0, 0.70, 1600.0, 1102.0),
    Tissue("gallbladder wall", 3.0, 0.70, 1600.0, 1090.0),
    Tissue("bile", -55.0, 0.05, 1534.0, 1015.0),
    Tissue("stone", 0.0, 5.00, 1600.0, 1150.0),
)
(GEL, LIVER, CORTEX, PYRAMID, SINUS, CAPSULE, DIAPHRAGM, BLOOD, WALL, GALLBLADDER_WALL, BILE,
 STONE) = range(len(TISSUES))  # fmt: skip

MM = 1e-3
TOP = (0.490, 0.010, 0.065)  # the organ's origin in the base frame, m
LENGTH, WIDTH, THICKNESS = 105.0, 52.0, 48.0  # outer size of the canonical kidney, mm
KIDNEY = (12.0, -14.0, -78.0)  # its centre, mm
NECK, FUNDUS = (-26.0, 40.0, -80.0), (28.0, 29.0, -58.0)  # ends of the gallbladder's axis, mm
SIDEWAYS = (0.0, 0.25, -1.0)
"""The beam that looks at the kidney through the liver, from the front and the right."""


class Variation(NamedTuple):
    """What a seed decides."""

    kidney: float = 1.0  # size of the kidney
    sinus: float = 1.0  # size of the renal sinus in the kidney; a larger one leaves less parenchyma
    gallbladder: float = 1.0  # width of the gallbladder
    turn: float = 0.0  # rotation of everything about the vertical, rad
    tilt: float = 0.0  # how much more the lower pole lies to the front, slope
    stone: float = 0.0  # radius of a gallstone, mm; none if 0


def abdomen(seed: int = 0) -> Anatomy:
    """Build an abdomen; seed 0 is the canonical one, in others sizes, tilt and stones vary."""
    varied = _variation(seed)
    kidney = _kidney_axes(varied.tilt)
    cos, sin = math.cos(varied.turn), math.sin(varied.turn)
    return Anatomy(
        name="abdomen",
        tissues=TISSUES,
        paint=lambda points: _paint(points / MM, varied, kidney),
        structures=tuple(
            Structure(name, to_point(centre * MM), radius * MM)
            for name, (centre, radius) in _structures(varied, kidney).items()
        ),
        views=_views(kidney),
        axes=((cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)),
        origin=TOP,
        home=(0.490, -0.005, 0.0, 0.0, 0.0, 0.75),
        wander=(0.490, 0.000, 0.75),
    )


def _variation(seed: int) -> Variation:
    if seed == 0:
        return Variation()
    draw = uniform(sample_seeds(seed, 1), 7)[0].tolist()
    return Variation(
        kidney=0.90 + 0.20 * draw[0],
        sinus=0.90 + 0.20 * draw[1],
        gallbladder=0.80 + 0.45 * draw[2],
        turn=0.35 * (draw[3] - 0.5),
        tilt=0.20 * (draw[4] - 0.5),
        stone=3.0 + 4.0 * draw[6] if draw[5] > 0.6 else 0.0,
    )


def _kidney_axes(tilt: float) -> Tensor:
    """Return the kidney's axes as rows: to the lower pole, to the hilum, to the front."""
    long_axis = normalize(torch.tensor([1.0, -0.22, 0.16 + tilt]), dim=0)
    hilum = torch.tensor([0.2, 0.9, 0.35])
    hilum = normalize(hilum - (hilum @ long_axis) * long_axis, dim=0)
    return torch.stack([long_axis, hilum, torch.linalg.cross(long_axis, hilum)])


# --- shapes, millimetres -------------------------------------------------------------------------

_LIVER = ((-15.0, -5.0, -52.0), (73.0, 80.0, 62.0))
_FOSSA = ((22.0, -14.0, -112.0), (74.0, 46.0, 60.0))
_CAVA = ((-90.0, 40.0, -98.0), (90.0, 38.0, -98.0))
_PORTAL = ((-14.0, 52.0, -70.0), (-26.0, 22.0, -62.0), (-34.0, -8.0, -52.0), (-30.0, -40.0, -46.0))
_HEPATIC = ((-62.0, 30.0, -84.0), (-56.0, 0.0, -62.0), (-42.0, -22.0, -40.0), (-18.0, -40.0, -28.0))


def _paint(p: Tensor, varied: Variation, kidney: Tensor) -> Tensor:
    """Return the tissue of (M, 3) points, mm."""
    tissue = torch.full((len(p),), GEL, dtype=torch.int64, device=p.device)
    _paint_liver(tissue, p)
    _paint_kidney(tissue, p, varied, kidney.to(p))
    _paint_gallbladder(tissue, p, varied)
    return tissue


def _paint_liver(tissue: Tensor, p: Tensor) -> None:
    u, _, w = p.unbind(-1)
    dome = ellipsoid(p, *_LIVER)
    liver = torch.maximum(subtract(dome, ellipsoid(p, *_FOSSA)), w + 12.0)
    tissue[(dome.abs() < 1.5) & (u < -5.0) & (w < -30.0)] = DIAPHRAGM
    tissue[liver.abs() < 0.8] = CAPSULE
    tissue[liver < -0.8] = LIVER
    portal, hepatic = tube(p, _PORTAL, (6.0, 5.0, 4.0, 3.0)), tube(p, _HEPATIC, (4.5, 4, 3.5, 2.5))
    cava = tube(p, _CAVA, (10.0, 10.0))
    tissue[(liver < 0.0) & (portal < 1.6)] = WALL
    tissue[cava < 1.6] = WALL
    tissue[((liver < 0.0) & (union(portal, hepatic) < 0.0)) | (cava < 0.0)] = BLOOD


def _paint_kidney(tissue: Tensor, p: Tensor, varied: Variation, axes: Tensor) -> None:
    local = (p - p.new_tensor(KIDNEY)) @ axes.T / varied.kidney
    outer = _kidney(local)
    tissue[outer < 1.4] = CAPSULE
    tissue[outer < 0.0] = CORTEX
    near = (outer < 4.0).nonzero().squeeze(1)
    inside = local[near]
    pyramids = union(*(capsule(inside, *pyramid, 1.0, 4.6) for pyramid in _pyramids()))
    sinus = _sinus(inside, varied.sinus)
    tissue[near[(pyramids < 0.0) & (outer[near] < -6.0)]] = PYRAMID
    tissue[near[sinus < 0.0]] = SINUS


def _kidney(local: Tensor) -> Tensor:
    """Distance to the outer surface, in the kidney's axes: an ellipsoid with a dent, the hilum."""
    bean = ellipsoid(local, (0.0, 0.0, 0.0), (LENGTH / 2, WIDTH / 2, THICKNESS / 2))
    return subtract(bean, ellipsoid(local, (0.0, 31.0, 0.0), (18.0, 13.0, 11.0)))


def _sinus(local: Tensor, size: float) -> Tensor:
    body = ellipsoid(local, (0.0, 3.0, 0.0), (31.0 * size, 9.0 * size, 8.0 * size))
    gate = capsule(local, (0.0, 4.0, 0.0), (0.0, 21.0, 0.0), 7.0 * size, 9.0 * size)
    return smooth_union(body, gate, 5.0)


def _pyramids() -> list[tuple[Point, Point]]:
    """Return tip and base of the pyramids, which stand around the sinus but not in the hilum."""
    pyramids = []
    for along in (25.0, 58.0, 90.0, 122.0, 155.0):
        for around in (90.0, 150.0, 210.0, 270.0):
            theta, phi = math.radians(along), math.radians(around)
            direction = (math.cos(theta), math.sin(theta) * math.cos(phi),
                         math.sin(theta) * math.sin(phi))  # fmt: skip
            tip = (33.0 * direction[0], 3.0 + 10.0 * direction[1], 9.0 * direction[2])
            base = (41.0 * direction[0], 16.5 * direction[1], 14.5 * direction[2])
            pyramids.append((tip, base))
    return pyramids


def _paint_gallbladder(tissue: Tensor, p: Tensor, varied: Variation) -> None:
    lumen = gallbladder(p, varied.gallbladder)
    tissue[lumen < 2.2] = GALLBLADDER_WALL
    tissue[lumen < 0.0] = BILE
    if varied.stone:
        # It lies where it falls: on the lower wall, near the middle.
        u, v, w = _between(0.6)
        centre = (u, v, w - 13.5 * varied.gallbladder + varied.stone)
        tissue[(p - p.new_tensor(centre)).norm(dim=-1) < varied.stone] = STONE


def gallbladder(p: Tensor, width: float) -> Tensor:
    """Distance of (M, 3) points, mm, to the gallbladder's lumen: a pear and the start of a duct."""
    path = (NECK, _between(0.25), _between(0.6), FUNDUS)
    pear = tube(p, path, [radius * width for radius in (4.0, 8.0, 12.5, 12.5)])
    duct = tube(p, ((-40.0, 50.0, -80.0), (-33.0, 43.0, -86.0), NECK), (2.0, 2.0, 2.5))
    return smooth_union(pear, duct, 3.0)


def _between(share: float) -> Point:
    """Return a point on the gallbladder's axis, from neck (0) to fundus (1)."""
    u, v, w = (a + share * (b - a) for a, b in zip(NECK, FUNDUS, strict=True))
    return u, v, w


# --- landmarks and views -------------------------------------------------------------------------


def _structures(varied: Variation, kidney: Tensor) -> dict[str, tuple[Tensor, float]]:
    """Return centre, mm, and the distance from the plane at which each is lost, mm."""
    centre, size = torch.tensor(KIDNEY), varied.kidney
    along, hilum, front = kidney * size
    beam = normalize(torch.tensor(SIDEWAYS), dim=0)
    neck, fundus = torch.tensor(NECK), torch.tensor(FUNDUS)
    middle = torch.tensor(_between(0.5))
    return {
        "kidney upper pole": (centre - 44.0 * along, 16.0),
        "kidney lower pole": (centre + 44.0 * along, 16.0),
        "renal sinus": (centre + 3.0 * hilum, 16.0),
        "renal hilum": (centre + 19.0 * hilum, 15.0),
        "lateral cortex": (centre - 21.0 * hilum, 15.0),
        "anterior cortex": (centre + 19.0 * front, 16.0),
        "liver over the kidney": (centre - 42.0 * beam, 20.0),
        "gallbladder neck": (neck, 13.0),
        "gallbladder body": (middle, 13.0),
        "gallbladder fundus": (fundus + 0.1 * (fundus - neck), 13.0),
        "liver over the gallbladder": (middle + torch.tensor([0.0, 0.0, 30.0]), 20.0),
    }


def _views(kidney: Tensor) -> tuple[ViewSpec, ...]:
    focus = to_point(torch.tensor(KIDNEY) * MM)
    sideways, down = torch.tensor(SIDEWAYS), torch.tensor([0.0, 0.0, -1.0])
    axis = torch.tensor(FUNDUS) - torch.tensor(NECK)
    return (
        ViewSpec(
            "KLX", focus, SIDEWAYS, to_point(torch.linalg.cross(sideways, kidney[0])),
            (("kidney upper pole", 1.0), ("kidney lower pole", 1.0), ("renal sinus", 1.5),
             ("liver over the kidney", 0.5)),
            title="kidney, longitudinal",
        ),
        ViewSpec(
            "KSX", focus, SIDEWAYS, to_point(kidney[0]),
            (("renal sinus", 1.0), ("renal hilum", 1.0), ("lateral cortex", 1.0),
             ("anterior cortex", 1.0), ("liver over the kidney", 0.5)),
            title="kidney, transverse",
        ),
        ViewSpec(
            "GB", to_point(torch.tensor(_between(0.6)) * MM), to_point(down),
            to_point(torch.linalg.cross(down, axis)),
            (("gallbladder neck", 1.0), ("gallbladder body", 1.5), ("gallbladder fundus", 1.0),
             ("liver over the gallbladder", 0.5)),
            title="gallbladder, longitudinal",
        ),
    )  # fmt: skip
