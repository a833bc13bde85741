# pyright: strict
"""The chest over the heart: tissue that gives under the probe, breathing, ribs and lung.

Ribs and lung are thin obstacles at fixed depths in the base frame; a beam that crosses one loses
sound there, in the picture and for the oracle alike. Ribs run crosswise and leave windows between
them; they are laid so that the parasternal and apical windows lie in spaces, where
echocardiographers find them. Lung covers what is far from these. Both end at the costal margin.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose, dot
from racines_data.patients.form import FOOT
from racines_data.patients.patient import Patient
from racines_data.patients.placement import SURFACE, Placement
from racines_data.patients.settings import PROBE
from racines_data.randomness import derive, uniform
from racines_data.world import breathed

GIVE = 45.0
"""Distance from the tip at which tissue is pushed half as far as under it, mm."""
RIB_DEPTH, LUNG_DEPTH = 0.62, 1.0
"""Where ribs and pleura lie, shares of the chest wall's thickness."""
MARGIN = 22.0  # from the costal margin to the subcostal window, mm
EDGE = 2.0  # over which an obstacle begins, mm
COVER_DEPTH, WAVES = 0.4, 8
"""Where uneven fat and muscle lie, share of the chest wall's thickness, and the waves they are."""
WAVELENGTHS = 9.0, 40.0  # of these, mm


class Chest(NamedTuple):
    """Of K patients, or of the B rows of a batch; mm, float64."""

    thickness: Tensor  # (K,)
    across: Tensor  # (K, 2) normal of the ribs
    offset: Tensor  # (K,) of a space's middle along that normal
    spacing: Tensor
    width: Tensor
    margin: Tensor  # (K, 2) level direction in which the ribs end
    last: Tensor  # (K,) where they do, along it
    rib_loss: Tensor  # (K,) dB one way
    lung_loss: Tensor
    notch: Tensor  # (K,) radius around the way from the first to the second window
    windows: Tensor  # (K, 2, 2) parasternal and apical
    cover: Tensor  # (K, 4, WAVES) of uneven tissue: turns a mm along x and y, phase, dB one way
    sway: Tensor  # (K, 3) of the heart, at full breath

    def rows(self, rows: Tensor) -> "Chest":
        """Return those of (B,) rows."""
        return Chest(*(each.index_select(0, rows) for each in self))


def chest_of(patient: Patient, placement: Placement, poses: Pose) -> list[Tensor]:
    """Return the fields of one patient, whose (V,) views have these poses, in label order."""
    chest, double = patient.chest, torch.float64
    foot = _footwards(placement)
    side = torch.stack([-foot[1], foot[0]])
    across = torch.nn.functional.normalize(foot + chest.slope * side, dim=0)
    crossing = _crossing(poses, RIB_DEPTH * chest.thickness) * 1e3
    apical, below, front = crossing[0], crossing[1], crossing[2:].mean(0)
    along = torch.stack([front @ across, apical @ across])
    spaces = max(1, round(float(along[1] - along[0]) / (1e3 * chest.rib_spacing)))
    spacing = (along[1] - along[0]).abs() / spaces
    margin = torch.nn.functional.normalize(below - (front + apical) / 2.0, dim=0)
    if float(spacing) < 24.0:  # windows side by side: one space holds both
        spacing = torch.tensor(1e3 * chest.rib_spacing, dtype=double)

    def number(value: float) -> Tensor:
        return torch.tensor(value, dtype=double)

    return [
        number(chest.thickness * 1e3), across, along[1], spacing,
        number(chest.rib_width * 1e3), margin, below @ margin - MARGIN,
        number(chest.rib_loss), number(chest.lung_loss), number(chest.notch * 1e3),
        torch.stack([front, apical]), _waves(patient),
        sway_of(patient, placement),
    ]  # fmt: skip


def _footwards(placement: Placement) -> Tensor:
    """Return the (2,) level direction towards the feet."""
    foot = torch.tensor(FOOT, dtype=torch.float64) @ placement.axes
    return torch.nn.functional.normalize(foot[:2], dim=0)


def sway_of(patient: Patient, placement: Placement) -> Tensor:
    """Return the (3,) float64 shift of a patient's heart at full breath, mm, base frame."""
    foot = _footwards(placement)
    return torch.cat([foot, foot.new_zeros(1)]) * (patient.motion.sway * 1e3)


def _waves(patient: Patient) -> Tensor:
    """Draw the (4, WAVES) plane waves of a patient's uneven cover."""
    draw = uniform(derive(torch.tensor([patient.seed]), 853), 3 * WAVES, 1)[0].double()
    length, way, phase = draw.view(3, WAVES)
    short, long = WAVELENGTHS
    turns = 1.0 / (short * (long / short) ** length)
    turn = 2.0 * math.pi * way
    size = torch.full_like(turns, patient.chest.cover * (2.0 / WAVES) ** 0.5)
    return torch.stack([turns * turn.cos(), turns * turn.sin(), phase, size])


def _crossing(poses: Pose, depth: float) -> Tensor:
    """Return (V, 2) where the central beams cross a depth, m."""
    down = poses.position[:, 2] - (SURFACE - depth)
    beam = poses.rotation[:, :, 2]
    return poses.position[:, :2] + beam[:, :2] * (down / -beam[:, 2]).unsqueeze(1)


def undeform(points: Tensor, tip: Tensor) -> Tensor:
    """Return where (B, ..., 3) points, mm, were before a probe at (B, 3) tips pressed.

    What touches the tip was skin; what lies GIVE away gave half as much.
    """
    tip = tip.view(-1, *[1] * (points.ndim - 2), 3)
    pressed = (SURFACE * 1e3 - tip[..., 2]).clamp_min(0.0)
    offset = points - tip
    away = dot(offset, offset) / GIVE**2
    return torch.cat([points[..., :2], (points[..., 2] + pressed / (1.0 + away)).unsqueeze(-1)], -1)


def deform(points: Tensor, tip: Tensor) -> Tensor:
    """Return where (B, N, 3) points, mm, are pushed to: the inverse of `undeform`."""
    x, y, z = (points - tip.unsqueeze(1)).unbind(-1)
    pressed = (SURFACE * 1e3 - tip[:, 2:]).clamp_min(0.0)
    aside, found = x.square() + y.square(), z
    for _ in range(4):  # the displacement changes by an eighth at most from mm to mm
        found = z - pressed / (1.0 + (aside + found.square()) / GIVE**2)
    return torch.stack([points[..., 0], points[..., 1], found + tip[:, 2:]], -1)


def breathing(chest: Chest, phase: Tensor) -> Tensor:
    """Return the (B, 3) shift of hearts at respiratory phases in [0, 1), mm; 0 breathed out."""
    return breathed(chest.sway, phase)


class Obstacles(NamedTuple):
    """What ribs and lung take from each beam."""

    loss: Tensor  # (B, L, 2) dB one way
    at: Tensor  # (B, L, 2) distance from the face, mm


def obstacles(pose: Pose, half_angle: Tensor, chest: Chest) -> Obstacles:
    """Find where the beams of (B,) float64 poses cross ribs and lung."""
    beam, tip = _beams(pose, half_angle)
    found: list[tuple[Tensor, Tensor]] = []
    for share, loss in ((RIB_DEPTH, _rib), (LUNG_DEPTH, _lung)):
        place, reach = _cross(beam, tip, share, chest)
        found.append((loss(place, chest), reach))
    losses, reaches = zip(*found, strict=True)
    return Obstacles(torch.stack(losses, -1), torch.stack(reaches, -1))


def _beams(pose: Pose, half_angle: Tensor) -> tuple[Tensor, Tensor]:
    """Return the (B, L, 3) directions of beams and the (B, 1, 3) tips they begin at, mm."""
    fan = torch.linspace(-1.0, 1.0, PROBE.beams, dtype=torch.float64, device=half_angle.device)
    angle = fan * half_angle.unsqueeze(1)
    x, z = pose.rotation[:, None, :, 0], pose.rotation[:, None, :, 2]
    beam = x * angle.sin().unsqueeze(-1) + z * angle.cos().unsqueeze(-1)
    return beam, pose.position.unsqueeze(1) * 1e3


def _cross(beam: Tensor, tip: Tensor, share: float, chest: Chest) -> tuple[Tensor, Tensor]:
    """Return where beams cross a share of the chest wall, (B, L, 2), and how far that is, mm."""
    # What touches the tip was skin: the wall under it is as thick as ever.
    down = beam.neg()[..., 2].clamp_min(0.05)
    reach = (share * chest.thickness.unsqueeze(1) / down).clamp_max(200.0)
    return tip[..., :2] + beam[..., :2] * reach.unsqueeze(-1), reach


def cover(pose: Pose, half_angle: Tensor, chest: Chest) -> Tensor:
    """Return (B, L) float32 dB, one way, that uneven fat and muscle take more or less than usual.

    It streaks the picture and hides nothing, so the oracle does not ask for it.
    """
    place, _ = _cross(*_beams(pose, half_angle), COVER_DEPTH, chest)
    across, aside, phase, size = chest.cover.unsqueeze(1).unbind(2)
    turns = place[..., :1] * across + place[..., 1:] * aside + phase
    return (torch.sin(2.0 * math.pi * turns) * size).sum(-1).float()


def _dot2(a: Tensor, b: Tensor) -> Tensor:
    """Return the products of (…, 2) vectors, as `geometry.dot` does."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _rib(place: Tensor, chest: Chest) -> Tensor:
    """Return (B, L) dB that ribs take at (B, L, 2) places."""
    along = _dot2(place, chest.across.unsqueeze(1))
    spacing = chest.spacing.unsqueeze(1)
    # Distance from the nearest rib's middle, half a space off the windows.
    away = (torch.remainder(along - chest.offset.unsqueeze(1), spacing) - spacing / 2.0).abs()
    inside = torch.sigmoid((chest.width.unsqueeze(1) / 2.0 - away) * (4.0 / EDGE))
    return chest.rib_loss.unsqueeze(1) * inside * _over_margin(place, chest)


def _over_margin(place: Tensor, chest: Chest) -> Tensor:
    """Return (B, L) 1 over the costal margin and 0 below it, where the subcostal window is."""
    beyond = _dot2(place, chest.margin.unsqueeze(1)) - chest.last.unsqueeze(1)
    return torch.sigmoid(-beyond / EDGE)


def _lung(place: Tensor, chest: Chest) -> Tensor:
    """Return (B, L) dB that lung takes at (B, L, 2) places."""
    first, second = chest.windows[:, None, 0], chest.windows[:, None, 1]
    way = second - first
    share = (_dot2(place - first, way) / _dot2(way, way)).clamp(0.0, 1.0)
    aside = place - first - share.unsqueeze(-1) * way
    away = _dot2(aside, aside).sqrt()
    covered = torch.sigmoid((away - chest.notch.unsqueeze(1)) * (2.0 / EDGE))
    return chest.lung_loss.unsqueeze(1) * covered * _over_margin(place, chest)


def shadows(found: Obstacles, uneven: Tensor, step: Tensor, samples: int) -> Tensor:
    """Return (B, L, S) float32 dB that are lost in each sample; `step` is (B,) mm."""
    loss = found.loss.float()
    index = (found.at / step.view(-1, 1, 1)).long().clamp(0, samples - 1)
    dense = loss.new_zeros((*loss.shape[:2], samples))
    dense[..., 0] = uneven
    return dense.scatter_add_(2, index, loss)


def transmission(found: Obstacles) -> Tensor:
    """Return (B, L) the share of the echo's amplitude that comes through, both ways."""
    return torch.pow(10.0, -found.loss.sum(-1) / 10.0)
