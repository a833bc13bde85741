# pyright: strict
"""How a heart beats: a smooth map from where tissue is now to where it was at end diastole.

Organ frame, millimetres, double. With `act` from 0 (end diastole) to 1 (end systole):

    along the axis   W = w - d·h(w)                the base comes d nearer to the apex, which stays
    across it        R² = r²/λ + C·min(1, r²/rₑ²) + D·t(r),     λ = dW/dw

The first term gives back across what shortening takes along; C = κ·Rₑ² is what the LV's inside
loses. Where r > rₑ, in the wall, R dR dW = r dr dw: the wall keeps its volume whatever C is, and
thickens; inside, the cavity shrinks evenly, so that κ is the ejection fraction. D does the same for
the right ventricle, between its septum (t = 0) and its free wall (t = 1). C may hang on direction
and height, so a region that moves badly keeps its volume, too. The atria widen while the base pulls
them longer. Each step only grows with r or with w, hence the map can be inverted: the Jacobian is
(R/r)·(dR/dr)·(dW/dw) times the atria's, each positive.

Last the RV's outflow tract, which lies above the annulus where none of this empties it, shrinks
towards its middle: R³ = r³·(1 + k·exp(-s)), s = (r/b)² in a metric that is longer along the tract;
R grows with r for every k < 18.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.patients.form import Shape
from racines_data.patients.labels import STAGES
from racines_data.patients.patient import Motion

SYSTOLE = 0.35
"""Share of the cardiac phase that is systole; see `rhythm` for its seconds."""
UPPER = 65.0  # above the annulus the pull of the base has faded, mm
RAMP = 18.0  # over which the ventricle's squeeze fades above the annulus, mm
ATRIA = 60.0, 30.0  # above the annulus the atria's widening begins to fade, and how fast, mm
RIGHT, FAR = 700.0, 9000.0
"""What the RV's free wall takes beyond its inside, and over which its pull fades then, mm²."""
TRACT = 6.0
"""k of the outflow tract at full contraction where the RV empties wholly."""
TRACT_SIZE = 1.3, 2.2
"""b across and along the tract, in its radii."""


class Dynamics(NamedTuple):
    """Of K hearts, or of the B rows of a batch; float64."""

    oval: Tensor  # (K, 3) xx, xy, yy of the map that makes the LV round
    semi: Tensor  # (K,) mm from here on: see `form.Shape`
    middle: Tensor
    half: Tensor
    apex: Tensor
    outer: Tensor  # from where the RV moves: outside of the thickest wall
    outer_half: Tensor
    right: Tensor  # (K, 3) centre of the RV's body
    right_semi: Tensor  # (K,) across
    right_half: Tensor
    tract: Tensor  # (K, 3) middle of the RV's outflow tract
    tract_way: Tensor  # (K, 3) direction along it
    tract_size: Tensor  # (K, 2) across and along it
    between: Tensor  # (K, 2) the middle between the atria
    emptying: Tensor  # (K,) of the LV where it moves normally
    right_emptying: Tensor
    shortening: Tensor  # mm
    atrial: Tensor
    kick: Tensor
    weak: Tensor
    weak_way: Tensor  # (K, 2) direction
    weak_height: Tensor  # (K,) mm

    def rows(self, rows: Tensor) -> "Dynamics":
        """Return those of (B,) rows."""
        return Dynamics(*(each.index_select(0, rows) for each in self))


def dynamics_of(shape: Shape, motion: Motion) -> list[Tensor]:
    """Return the fields of one heart."""
    form = shape.form
    cos, sin = math.cos(form.oval_turn), math.sin(form.oval_turn)
    wide, narrow = form.oval**0.5, form.oval**-0.5
    oval = (
        wide * cos * cos + narrow * sin * sin,
        (wide - narrow) * sin * cos,
        wide * sin * sin + narrow * cos * cos,
    )
    left, right = shape.left_atrium.centre, shape.right_atrium.centre
    tract = shape.outflow
    begin, end = tract.path[1], tract.path[3]
    way = tuple(b - a for a, b in zip(begin, end, strict=True))
    values: list[float | tuple[float, ...]] = [
        oval, shape.semi, shape.middle, shape.half, form.length,
        shape.semi + 1.05 * max(form.wall, form.septum) + 0.5, shape.lv_outer.radii[2] + 2.0,
        shape.right.centre, shape.right.radii[0], shape.right.radii[2],
        tract.path[2], tuple(each / math.hypot(*way) for each in way),
        tuple(size * tract.radii[2] for size in TRACT_SIZE),
        ((left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0),
        motion.emptying, motion.right_emptying, motion.shortening, motion.atrial, motion.kick,
        motion.weak, (math.cos(motion.weak_at), math.sin(motion.weak_at)),
        motion.weak_height * form.length,
    ]  # fmt: skip
    return [torch.tensor(value, dtype=torch.float64) for value in values]


def step(x: Tensor) -> Tensor:
    """Return a smooth step from 0 to 1 over 0 to 1."""
    x = x.clamp(0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def activation(phase: Tensor, kick: Tensor) -> Tensor:
    """Return (B,) how far the ventricles are contracted at cardiac phases in [0, 1)."""
    early = (1.0 - kick) * step((phase - 0.40) / 0.20)
    return step(phase / SYSTOLE) - early - kick * step((phase - 0.85) / 0.14)


def valve_stages(phase: Tensor, kick: Tensor) -> Tensor:
    """Return (B,) int64: 4 times the stage of the valves to the ventricles, plus the aortic one."""
    filling = step((phase - 0.40) / 0.06) - 0.55 * step((phase - 0.55) / 0.10)
    again = 0.45 * (kick > 0.0).to(phase)
    filling = filling + again * step((phase - 0.84) / 0.06)
    filling = filling - (0.45 + again) * step((phase - 0.92) / 0.07)
    ejecting = step((phase - 0.03) / 0.05) - step((phase - 0.30) / 0.06)
    return _stage(filling) * STAGES + _stage(ejecting)


def _stage(share: Tensor) -> Tensor:
    """Return the stage of a valve that is open by a share."""
    return (share * (STAGES - 0.001)).clamp(0, STAGES - 1).long()


def all_stages() -> Tensor:
    """Return (16, 3) stages of mitral, tricuspid and aortic valve, as `valve_stages` counts."""
    rows = [(a, a, b) for a in range(STAGES) for b in range(STAGES)]
    return torch.tensor(rows)


def to_diastole(points: Tensor, dynamics: Dynamics, act: Tensor) -> Tensor:
    """Return where (B, ..., 3) points of beating hearts were at end diastole; `act` is (B,)."""
    flat = points.flatten(1, -2)
    u, v, w = flat.unbind(-1)
    motion = Dynamics(*(each.unsqueeze(1) for each in dynamics))
    act = act.unsqueeze(1)
    height, stretch, above = _along(w, motion, act)
    xx, xy, yy = motion.oval.unbind(-1)
    x, y = xx * u + xy * v, xy * u + yy * v
    square = x * x + y * y + 1e-9
    grown = _across(x, y, square, height, stretch, motion, act)
    wider = _atria(above, motion, act)
    left, front = motion.between.unbind(-1)
    scale = grown.sqrt()
    u, v = left + wider * (u * scale - left), front + wider * (v * scale - front)
    return _tract(torch.stack([u, v, height], -1), motion, act).view(points.shape)


def _tract(points: Tensor, motion: Dynamics, act: Tensor) -> Tensor:
    """Return where (B, N, 3) points near the outflow tract were before it shrank."""
    way = points - motion.tract
    along = (way * motion.tract_way).sum(-1)
    across, length = motion.tract_size.square().unbind(-1)
    far = (way.square().sum(-1) - along.square()) / across + along.square() / length
    grown = 1.0 + TRACT * motion.right_emptying * act * torch.exp(-far)
    return motion.tract + way * grown.pow(1.0 / 3.0).unsqueeze(-1)


def _along(w: Tensor, motion: Dynamics, act: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return W, the stretch λ that is made up for across, and the height above the annulus."""
    descent = motion.shortening * act
    length = motion.apex - descent
    x = ((motion.apex - w) / length).clamp(0.0, 1.0)
    above = (descent - w).clamp_min(0.0)
    height = w - descent * (x * x * (2.0 - x) - step(above / UPPER))
    stretch = 1.0 + descent / length * (x * (4.0 - 3.0 * x)) * (1.0 - step(above / RAMP))
    return height, stretch, above


def _across(
    x: Tensor, y: Tensor, square: Tensor, height: Tensor, stretch: Tensor, motion: Dynamics,
    act: Tensor,
) -> Tensor:  # fmt: skip
    """Return R²/r², of the LV's and the RV's squeeze."""
    fade = (1.0 + height / RAMP).clamp(0.0, 1.0)
    inside = _ellipse(motion.semi, height - motion.middle, motion.half)
    cos, sin = x / square.sqrt(), y / square.sqrt()
    toward = (1.0 + cos * motion.weak_way[..., 0] + sin * motion.weak_way[..., 1]) / 2.0
    tall = (1.0 - ((height - motion.weak_height) / (0.45 * motion.apex)).square()).clamp_min(0.0)
    taken = motion.emptying * act * fade * inside * (1.0 - motion.weak * toward.square() * tall)
    endocardium = stretch * (inside - taken)
    grown = 1.0 / stretch + taken / torch.maximum(square, endocardium + 1e-6)
    # The right ventricle, from the LV's outside to its free wall in this direction.
    outside = _ellipse(motion.outer, height - motion.middle, motion.outer_half)
    room = _room(cos, sin, height, outside, motion)
    lost = motion.right_emptying * act * fade * room
    start, span = stretch * (outside - taken), stretch * (room - lost)
    beyond = square - start
    share = (beyond / (span + 1.0)).clamp(0.0, 1.0)
    share = share * (1.0 - (beyond - span - RIGHT).clamp_min(0.0) / FAR).clamp_min(0.0)
    return grown + lost * share / square


def _ellipse(semi: Tensor, height: Tensor, half: Tensor) -> Tensor:
    """Return the squared radius of an ellipsoid at a height over its middle."""
    return semi.square() * (1.0 - (height / half).square()).clamp_min(0.0)


def _room(cos: Tensor, sin: Tensor, height: Tensor, outside: Tensor, motion: Dynamics) -> Tensor:
    """Return by how much the RV's free wall lies beyond the LV's outside, in squared radii."""
    across, front, level = motion.right.unbind(-1)
    ring = _ellipse(motion.right_semi, height - level, motion.right_half)
    near = across * cos + front * sin
    under = (ring - across.square() - front.square() + near.square()).clamp_min(0.0)
    wall = (near + under.sqrt()).clamp_min(0.0)
    return (wall.square() - outside).clamp_min(0.0) * (under / (under + 60.0))


def _atria(above: Tensor, motion: Dynamics, act: Tensor) -> Tensor:
    """Return by how much the atria were narrower at end diastole."""
    top, fade = ATRIA
    return 1.0 - motion.atrial * act * step(above / RAMP) * (1.0 - step((above - top) / fade))


def from_diastole(points: Tensor, dynamics: Dynamics, act: Tensor, steps: int = 60) -> Tensor:
    """Return where (B, N, 3) points at end diastole are now: the inverse, by damped iteration."""
    found = points.clone()
    for _ in range(steps):
        found = found + 0.55 * (points - to_diastole(found, dynamics, act))
    return found
