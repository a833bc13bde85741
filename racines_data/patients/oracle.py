# pyright: strict
"""What is true at a pose of a moved heart: the phantom's oracle, row by row.

A structure is seen as far as it lies in the plane and the sector, and as far as sound comes to it
and back: through the face that touches, past ribs and lung. The landmarks are the moved ones.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose, dot
from racines_data.patients.chest import Chest, deform, obstacles, transmission
from racines_data.patients.placement import SURFACE
from racines_data.patients.settings import PROBE, Settings
from racines_data.phantom.truth import (
    MEMBERSHIP_CENTRE,
    MEMBERSHIP_WIDTH,
    ROLL_FREE,
    ROLL_LOST,
    WINDOW_FREE,
    WINDOW_LOST,
    coupling,
)
from racines_data.world import Truth


class Sight(NamedTuple):
    """How far each structure is seen."""

    visibility: Tensor  # (B, S) 0-1
    clarity: Tensor  # (B,) 0-1


def look(pose: Pose, marks: Tensor, radii: Tensor, settings: Settings, chest: Chest) -> Sight:
    """See what (B,) float64 poses show of (B, S, 3) landmarks.

    Ribs and lung are looked through once: give landmarks at several moments side by side.

    Args:
        pose: metres, base frame.
        marks: mm, base frame, where the heart's beat and the breath have brought them.
        radii: (S,) distance from the plane at which each is all but lost, mm.
        settings: of the rows.
        chest: of the rows.
    """
    touching = coupling(pose, SURFACE, PROBE)
    through = transmission(obstacles(pose, settings.half_angle, chest))
    tip = pose.position * 1e3
    offset = deform(marks, tip) - tip.unsqueeze(1)
    axes = pose.rotation.unsqueeze(1)
    lateral, elevation, axial = (dot(offset, axes[..., i]) for i in range(3))
    in_plane = torch.exp(-0.5 * (elevation / (0.6 * radii)).square())
    radius = (lateral.square() + axial.square()).sqrt()
    angle, half = torch.atan2(lateral, axial), settings.half_angle.unsqueeze(1)
    depth = settings.step.unsqueeze(1) * PROBE.samples
    in_sector = torch.sigmoid((half - angle.abs()) * radius / 2.0)
    in_depth = torch.sigmoid((depth - radius) / 2.0)
    last = PROBE.beams - 1
    beam = ((angle / half + 1.0) * 0.5 * last).clamp(0.0, last)
    heard = _between(touching * through, beam).clamp_min(1e-9).sqrt()
    return Sight(in_plane * in_sector * in_depth * heard, (touching * through.sqrt()).mean(-1))


def _between(values: Tensor, beam: Tensor) -> Tensor:
    """Return (B, S) values of (B, L) at beams' fractions: no beam is chosen by a last bit."""
    below = beam.floor().clamp_max(values.shape[1] - 2).long()
    low, high = values.gather(1, below), values.gather(1, below + 1)
    return torch.lerp(low, high, beam - below)


def completeness(seen: Tensor, weights: Tensor) -> Tensor:
    """Return weighted geometric means of (..., S), since one lost structure spoils a view."""
    return (weights * seen.clamp_min(0.02).log()).sum(-1).exp()


def scores(pose: Pose, visibility: Tensor, weights: Tensor, targets: Pose) -> Tensor:
    """Return (…, B, V) in 0-1, how completely and how properly each view is shown.

    Args:
        pose: (B,).
        visibility: (…, B, S), at one moment or at several.
        weights: (V, S).
        targets: (B, V) nominal poses of the rows' patients.
    """
    shown = completeness(visibility.unsqueeze(-2), weights)
    return shown * (_display(pose, targets) * _window(pose, targets))


def judge(score: Tensor, visibility: Tensor, clarity: Tensor) -> Truth:
    """Judge by (…, B, V) scores, (…, B, S) visibility and (B,) clarity, all moments at once."""
    membership = torch.sigmoid((score - MEMBERSHIP_CENTRE) / MEMBERSHIP_WIDTH)
    membership = membership * torch.sigmoid((clarity - 0.35) / 0.04).unsqueeze(-1)
    best, view = membership.max(-1)
    attained = best > 0.5
    progress = ((score - 0.5) / 0.45).clamp(0.0, 1.0)
    grade = (10.0 * progress * clarity.clamp(0.0, 1.0).unsqueeze(-1)).clamp(0.0, 10.0)
    own = grade.gather(-1, view.unsqueeze(-1)).squeeze(-1).clamp_min(1.0)
    return Truth(
        view=torch.where(attained, view, membership.shape[-1]),  # Random
        grade=torch.where(attained, own, 0.0).float(),
        membership=membership.float(),
        view_grade=grade.float(),
        clarity=clarity.expand(view.shape).float(),
        visibility=visibility.float(),
    )


def _display(pose: Pose, targets: Pose) -> Tensor:
    """Return (B, V) in 0-1: how near the picture is turned to the standard display."""
    beam = pose.rotation[:, None, :, 2]
    lateral, axial = targets.rotation[..., 0], targets.rotation[..., 2]
    roll = torch.atan2(dot(beam, lateral), dot(beam, axial)).abs()
    upright = ((ROLL_LOST - roll) / (ROLL_LOST - ROLL_FREE)).clamp(0.0, 1.0)
    facing = dot(pose.rotation[:, None, :, 1], targets.rotation[..., 1])
    return upright * (3.0 - 2.0 * upright) * upright * (facing > 0.0)


def _window(pose: Pose, targets: Pose) -> Tensor:
    """Return (B, V) in 0-1: how near the probe stands to the view's acoustic window."""
    x, y = (pose.position[:, None, :2] - targets.position[..., :2]).unbind(-1)
    away = (x.square() + y.square()).sqrt()
    near = ((WINDOW_LOST - away) / (WINDOW_LOST - WINDOW_FREE)).clamp(0.0, 1.0)
    return (3.0 - 2.0 * near) * near * near
