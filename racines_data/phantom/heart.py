"""The heart in the block: a static adult heart without valve leaflets, as the CAE block holds.

Organ frame, metres: u towards the left ventricle's lateral wall, v anterior, w from base to apex;
the origin is the centre of the mitral annulus. The directions are right-handed (left x anterior =
towards the apex). `s` is the anteroseptal direction, 120° from u, in which a parasternal probe
looks; `t` = s x w is the normal of the parasternal long-axis plane.

Dimensions are those of a normal adult (Lang et al., Recommendations for Cardiac Chamber
Quantification, JASE 2015): LV 44 mm by 76 mm inside, walls 9 mm, LA 36-45 mm, RV base 35 mm, free
wall 4 mm, aortic root 29 mm. Acoustic values are from Duck, Physical Properties of Tissue (1990)
and Szabo, Diagnostic Ultrasound Imaging (2014), tables of speed, density and attenuation.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import normalize

from racines_data.phantom.anatomy import Anatomy, Point, Structure, Tissue, ViewSpec, to_point
from racines_data.phantom.shapes import capsule, ellipsoid, smooth_union, subtract, tube, union
from racines_data.randomness import sample_seeds, uniform

TISSUES = (
    Tissue("gel", -13.0, 0.50, 1540.0, 1040.0, 1.0),
    Tissue("myocardium", 0.0, 0.52, 1561.0, 1081.0, 3.5, 4.5, True),
    Tissue("blood", -34.0, 0.14, 1578.0, 1050.0),
    Tissue("vessel wall", 2.0, 0.70, 1600.0, 1102.0, 3.0, 4.5, True),
    Tissue("pericardium", 5.0, 1.20, 1665.0, 1120.0, 3.0, 4.5, True),
    Tissue("connective tissue", 6.0, 0.90, 1610.0, 1090.0, 4.0, 4.5, True),
)
GEL, MYOCARDIUM, BLOOD, WALL, PERICARDIUM, CONNECTIVE = range(6)

MM = 1e-3
S = (-0.5, math.sqrt(0.75), 0.0)
T = (math.sqrt(0.75), 0.5, 0.0)
W = (0.0, 0.0, 1.0)

# Up in the organ frame: apex, anterior and right side face the scanned surface, so that the
# apical, subcostal and parasternal windows all lie on one flat top.
DOWN = (0.45, -0.60, -0.66)
HEADING = 3.83  # rotation of the heart about the vertical, rad
ORIGIN = (0.4673, 0.0013)  # x and y of the heart's reference point in the base frame, m
REFERENCE = (0.0, 0.0, 35.0)  # the reference point: the middle of the LV, organ frame, mm
REFERENCE_DEPTH = 0.0575  # depth of the reference point under the surface at z = 0.065, m


@dataclass(frozen=True)
class _Form:
    """What varies from heart to heart; the defaults are the canonical heart."""

    size: float = 1.0
    wall: float = 1.0  # thickness of the walls
    turn: float = 0.0  # rotation about the vertical, rad
    ventricle: float = 1.0  # width of the left ventricle against its length
    right: float = 1.0  # width of the right ventricle
    atria: float = 1.0  # radius of the atria
    gel: float = -13.0  # backscatter of the surroundings, dB
    unevenness: float = 1.0  # how unevenly they scatter, dB
    blood: float = -34.0  # backscatter of blood, dB
    patchiness: float = 3.5  # slow variation of the walls' backscatter, dB
    grain: float = 0.0  # fine variation of the surroundings' backscatter, dB
    layers: float = 0.0  # share of the surroundings that is layers of connective tissue
    layer_seed: int = 0


def heart(seed: int = 0) -> Anatomy:
    """Build a heart; seed 0 is the canonical one.

    Others vary size, walls, chambers, orientation and the echogenicity of blood and surroundings.
    """
    form = _form(seed)
    size = form.size
    axes, origin = _placement(form.turn)
    gel, myocardium, blood, *rest = TISSUES
    return Anatomy(
        name="heart",
        tissues=(
            replace(gel, echogenicity=form.gel, texture=form.unevenness, grain=form.grain),
            replace(myocardium, texture=form.patchiness),
            replace(blood, echogenicity=form.blood),
            *rest,
        ),
        paint=lambda points: _paint(points / (MM * size), form),
        structures=tuple(
            Structure(name, _scaled(centre, size), radius * MM * size)
            for name, (centre, radius) in _STRUCTURES.items()
        ),
        views=tuple(replace(view, focus=_scaled(view.focus, size)) for view in _VIEWS),
        axes=axes,
        origin=origin,
        home=(0.4830, 0.0595, 0.0, -0.116, 0.070, 1.98),
        wander=(0.5070, 0.0350, 1.80),
    )


def _form(seed: int) -> _Form:
    if seed == 0:
        return _Form()
    draw = uniform(sample_seeds(seed, 1), 12)[0].tolist()
    low_high = (
        (0.90, 1.08), (0.80, 1.20), (-0.175, 0.175), (0.86, 1.12), (0.85, 1.10), (0.85, 1.12),
        (-11.0, 1.0), (3.0, 7.0), (-36.0, -28.0), (2.5, 6.0),
        (2.0, 6.0), (0.2, 0.8),
    )  # fmt: skip
    values = (a + (b - a) * x for x, (a, b) in zip(draw, low_high, strict=True))
    return _Form(*values, layer_seed=seed)


def _scaled(point: Point, size: float) -> Point:
    return (point[0] * MM * size, point[1] * MM * size, point[2] * MM * size)


def _along(s: float, t: float, w: float) -> Point:
    """Return the point with coordinates along s, t and w."""
    return (s * S[0] + t * T[0], s * S[1] + t * T[1], w)


# --- shapes, millimetres -------------------------------------------------------------------------

_LA = (0.0, -10.0, -25.0)
_RA = (-43.0, -4.0, -23.0)
_AORTA = (_along(14.0, 0.0, 8.0), _along(18.0, 0.0, -6.0), _along(21.0, 1.0, -16.0),
          _along(22.0, -2.0, -34.0), _along(22.0, -5.0, -60.0))  # fmt: skip
_AORTA_RADII = (10.0, 11.0, 14.5, 12.5, 12.5)
_OUTFLOW = (_along(34.0, -30.0, 30.0), _along(44.0, -16.0, 8.0), _along(50.0, 2.0, -12.0),
            _along(38.0, 27.0, -20.0), _along(14.0, 38.0, -28.0))  # fmt: skip
_OUTFLOW_RADII = (12.0, 14.0, 13.0, 11.5, 11.0)
_PULMONARY = (_OUTFLOW[-1], _along(-4.0, 42.0, -34.0))


def _paint(p: Tensor, form: _Form) -> Tensor:
    """Return the tissue of (M, 3) points, mm of a heart of size 1."""
    lv_wall, rv_wall, atrial_wall = 9.5 * form.wall, 4.0 * form.wall, 2.5 * form.wall
    wide, right = 22.5 * form.ventricle, 36.0 * form.right
    u, v, w = p.unbind(-1)
    lv = torch.maximum(ellipsoid(p, (0, 0, 16.0), (wide, wide, 60.0)), -w)
    thick = wide + lv_wall
    lv_outer = torch.maximum(ellipsoid(p, (0, 0, 16.0), (thick, thick, 60.0 + lv_wall)), -w - 4.0)
    la = ellipsoid(p, _LA, tuple(form.atria * r for r in (21.0, 19.0, 22.0)))
    ra = ellipsoid(p, _RA, tuple(form.atria * r for r in (19.0, 22.0, 22.0)))
    aorta = tube(p, _AORTA, _AORTA_RADII)
    # The RV body wraps the septum: an ellipsoid on the septal side, less the LV and its septum.
    rv_body = torch.maximum(ellipsoid(p, (-27.0, 8.0, 19.0), (right, right, 50.0)), -w + 1.0)
    outflow = tube(p, _OUTFLOW, _OUTFLOW_RADII)
    rv = smooth_union(rv_body, outflow, 6.0)
    pulmonary = tube(p, _PULMONARY, (11.0, 9.0))
    rv_cavity = subtract(subtract(rv, lv_outer), aorta - 2.5)
    mitral = capsule(p, (2.0, -4.0, 4.0), (2.0, -8.0, -12.0), 15.0, 14.5)
    tricuspid = capsule(p, (-46.0, 2.0, 6.0), (-45.0, -2.0, -12.0), 13.0, 14.0)
    papillary = union(
        capsule(p, _along(-14.0, 14.0, 44.0), _along(-9.0, 9.0, 24.0), 5.5, 3.0),
        capsule(p, _along(-14.0, -14.0, 44.0), _along(-9.0, -9.0, 24.0), 5.5, 3.0),
    )
    trabecula = capsule(p, (-22.0, 8.0, 44.0), (-44.0, 6.0, 38.0), 2.2, 3.0)  # moderator band

    blood = union(
        subtract(lv, papillary), subtract(rv_cavity, trabecula), la, ra, aorta, pulmonary,
        mitral, tricuspid,
    )  # fmt: skip
    atria = union(la, ra)
    # Septa: the atria and the aortic root are kept apart by their walls.
    septum = torch.maximum(atria, (la - ra).abs() / 2 - atrial_wall / 2)
    root = torch.maximum(torch.maximum(atria, aorta - 2.5), -aorta)
    muscle = union(lv_outer, subtract(rv, lv_outer) - rv_wall)
    atria_outer = atria - atrial_wall
    vessels = union(aorta - 2.2, pulmonary - 2.0, outflow - 2.5)
    heart_outer = union(muscle, atria_outer, vessels)

    tissue = torch.full_like(u, GEL, dtype=torch.int64)
    if form.layers:
        tissue[_layers(p, form) & (heart_outer > 3.0)] = CONNECTIVE
    tissue[heart_outer < 1.4] = PERICARDIUM
    tissue[heart_outer < 0.0] = MYOCARDIUM
    tissue[torch.minimum(vessels, atria_outer) < 0.0] = WALL
    tissue[torch.minimum(lv_outer, rv - rv_wall) < 0.0] = MYOCARDIUM
    tissue[(aorta - 2.2 < 0.0) & (w < 2.0)] = WALL
    tissue[blood < 0.0] = BLOOD
    in_septum = (septum < 0.0) & (mitral > 0.0) & (tricuspid > 0.0) & (aorta > 0.0)
    in_root = (root < 0.0) & (aorta > 0.0) & (mitral > 0.0)
    tissue[in_septum | in_root] = WALL
    return tissue


def _layers(p: Tensor, form: _Form) -> Tensor:
    """Return where (M, 3) points lie in a layer: the nodes of a few random plane waves."""
    draw = uniform(sample_seeds(form.layer_seed, 1), 6 * 4, 7)[0].view(6, 4)
    way = normalize(draw[:, :3] - 0.5, dim=1)
    wave = torch.sin(p @ (way * (0.10 + 0.10 * draw[:, 3:])).T + 2.0 * math.pi * draw[:, 3])
    return wave.mean(1).abs() < 0.3 * form.layers


# --- landmarks and views -------------------------------------------------------------------------

_STRUCTURES: dict[str, tuple[Point, float]] = {
    # name: (centre, distance from the plane at which it is lost), mm
    "LV apex": ((0.0, 0.0, 72.0), 14.0),
    "LV": ((0.0, 0.0, 30.0), 16.0),
    "LV lateral wall": ((25.0, 0.0, 20.0), 16.0),
    "septum": ((-25.0, 0.0, 25.0), 16.0),
    "RV": ((-45.0, 2.0, 16.0), 18.0),
    "LA": (_LA, 18.0),
    "RA": (_RA, 18.0),
    "crux": ((-25.0, -4.0, -3.0), 14.0),
    "aortic root": (_along(20.5, 0.0, -14.0), 11.0),
    "aortic outflow": (_along(15.0, 0.0, 4.0), 11.0),
    "anteroseptum": (_along(26.0, 0.0, 24.0), 12.0),
    "posterior wall": (_along(-26.0, 0.0, 20.0), 14.0),
    "RVOT": (_OUTFLOW[2], 13.0),
    "RV outflow": (_along(43.0, -2.0, 10.0), 16.0),
    "pulmonary trunk": (_along(32.0, 30.0, -21.0), 15.0),
    "LA below root": ((2.0, -9.0, -20.0), 16.0),
    "RA beside root": ((-40.0, -3.0, -18.0), 18.0),
    "mitral annulus anterior": (_along(8.0, 0.0, 4.0), 11.0),
    "mitral annulus posterior": (_along(-22.0, 0.0, 4.0), 11.0),
    "mitral annulus lateral": (_along(-4.0, 20.0, 4.0), 11.0),
    "mitral annulus septal": (_along(-4.0, -20.0, 4.0), 11.0),
    "RV base": ((-46.0, 8.0, 8.0), 14.0),
}

_FOUR = (("LV", 1.5), ("LV apex", 1.0), ("septum", 1.0), ("LV lateral wall", 1.0), ("RV", 1.0),
         ("LA", 1.0), ("RA", 1.0), ("crux", 1.0))  # fmt: skip


def _in_plane(first: Point, degrees: float) -> Point:
    """Rotate from -w (apical) towards `first` by an angle: a beam of a long-axis plane."""
    angle = math.radians(degrees)
    sin, cos = math.sin(angle), math.cos(angle)
    return (sin * first[0], sin * first[1], sin * first[2] - cos)


_FOUR_NORMAL = (0.0, -1.0, 0.05)
_VIEWS = (  # focus: mm
    ViewSpec("A4C", (-9.0, -1.5, 20.0), _in_plane((1.0, 0.0, 0.0), 5.0), _FOUR_NORMAL, _FOUR),
    ViewSpec("SC", (-10.0, -1.5, 22.0), _in_plane((1.0, 0.0, 0.0), 46.0), _FOUR_NORMAL,
             (("LV", 1.5), *_FOUR[2:])),
    ViewSpec("PL", _along(2.0, 0.0, 8.0), _in_plane((-S[0], -S[1], 0.0), 68.0), T,
             (("LV", 1.0), ("anteroseptum", 1.0), ("posterior wall", 1.0), ("aortic root", 1.5),
              ("aortic outflow", 1.0), ("LA below root", 1.0), ("RV outflow", 0.5))),
    ViewSpec("PSAV", _along(14.0, 0.0, -16.0), (0.6, -0.8, 0.0), W,
             (("aortic root", 2.0), ("RVOT", 1.0), ("pulmonary trunk", 1.0), ("LA below root", 1.0),
              ("RA beside root", 1.0))),
    ViewSpec("PSMV", _along(0.0, 0.0, 6.0), (0.6, -0.8, 0.0), W,
             (("mitral annulus anterior", 1.0), ("mitral annulus posterior", 1.0),
              ("mitral annulus lateral", 1.0), ("mitral annulus septal", 1.0), ("RV base", 1.0))),
)  # fmt: skip


def _placement(turn: float) -> tuple[tuple[Point, ...], Point]:
    """Return the organ's axes (rows u, v, w in the base frame) and its origin."""
    down = normalize(torch.tensor(DOWN, dtype=torch.float64), dim=0)
    # Horizontal directions in the organ frame: the long axis projected, and its perpendicular.
    long_axis = torch.tensor(W, dtype=torch.float64)
    forward = normalize(long_axis - (long_axis @ down) * down, dim=0)
    side = torch.linalg.cross(-down, forward)
    cos, sin = math.cos(HEADING + turn), math.sin(HEADING + turn)
    base = cos * forward - sin * side, sin * forward + cos * side, -down
    axes = torch.stack(base, dim=-1)  # row i: organ axis i in base coordinates
    target = torch.tensor([*ORIGIN, 0.065 - REFERENCE_DEPTH], dtype=torch.float64)
    origin = target - axes.T @ (torch.tensor(REFERENCE, dtype=torch.float64) * MM)
    return tuple(to_point(row) for row in axes), to_point(origin)
