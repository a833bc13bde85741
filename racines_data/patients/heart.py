# pyright: strict
"""One patient made ready: shape, place, depth of the sector, and nominal poses."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_data.patients.chest import Chest, chest_of
from racines_data.patients.form import Shape, shape_of
from racines_data.patients.landmarks import landmarks, view_specs
from racines_data.patients.motion import Dynamics, dynamics_of, from_diastole
from racines_data.patients.nominal import Found, Scene, find_poses
from racines_data.patients.patient import Patient
from racines_data.patients.placement import Placement, depth_to_hold, geometric_poses, place
from racines_data.patients.settings import Settings, settings_of

LEVELS = 13
"""Stages of contraction at which the landmarks' ways are kept."""
STILL, BEATING = (0,), (0, (LEVELS - 1) // 2, LEVELS - 1)
"""Levels over which nominal poses are to be good."""


@dataclass(frozen=True)
class Heart:
    """A patient's heart in its chest, without its voxels."""

    patient: Patient
    shape: Shape
    placement: Placement
    settings: Settings  # one row
    chest: Chest  # one row
    dynamics: Dynamics  # one row
    tracks: Tensor  # (LEVELS, S, 3) landmarks from end diastole to end systole, organ frame, mm
    radii: Tensor  # (S,) mm
    weights: Tensor  # (V, S), rows sum to one
    found: Found  # nominal poses


@lru_cache(maxsize=512)
def make_heart(patient: Patient, beating: bool) -> Heart:
    """Make a patient ready; nominal poses suit a still heart or one that beats."""
    shape = shape_of(patient.form)
    placement = place(shape, patient)
    start = geometric_poses(shape, placement)
    depth = depth_to_hold(shape, placement, start, patient.examination.margin)
    dynamics = Dynamics(*_row(dynamics_of(shape, patient.motion)))
    marks = landmarks(shape)
    radii = torch.tensor([mark.radius for mark in marks], dtype=torch.float64)
    weights = _weights(shape, [mark.name for mark in marks])
    tracks = _tracks(torch.tensor([mark.centre for mark in marks], dtype=torch.float64), dynamics)
    seen = Seen(tracks, radii, weights, BEATING if beating else STILL)
    return assemble(patient, shape, placement, start, depth, seen)


class Seen(NamedTuple):
    """What views show of a heart, and where it is over the beat."""

    tracks: Tensor  # (T, S, 3) landmarks, organ frame, mm
    radii: Tensor  # (S,) mm
    weights: Tensor  # (V, S), rows sum to one
    moments: tuple[int, ...]  # of the T over which nominal poses are to be good


def assemble(
    patient: Patient, shape: Shape, placement: Placement, start: Pose, depth: float, seen: Seen
) -> Heart:
    """Join a heart, its chest and its settings, and search its nominal poses.

    Args:
        patient: who.
        shape: of the heart.
        placement: where it lies.
        start: (V,) poses where the search begins, and by which windows between ribs are laid.
        depth: of the sector, m.
        seen: landmarks and views.
    """
    settings = Settings(*_row(settings_of(patient, placement, depth, shape)))
    chest = Chest(*_row(chest_of(patient, placement, start)))
    dynamics = Dynamics(*_row(dynamics_of(shape, patient.motion)))
    tracks, radii, weights, moments = seen
    marks = placement.to_base(tracks[list(moments)]) * 1e3
    found = find_poses(start, Scene(marks, radii, weights, settings, chest))
    return Heart(
        patient, shape, placement, settings, chest, dynamics, tracks, radii, weights, found
    )


def _row(fields: list[Tensor]) -> list[Tensor]:
    return [field.unsqueeze(0) for field in fields]


def _weights(shape: Shape, names: list[str]) -> Tensor:
    views = view_specs(shape)
    weights = torch.zeros((len(views), len(names)), dtype=torch.float64)
    for row, view in enumerate(views):
        for name, weight in view.structures:
            weights[row, names.index(name)] = weight
    return weights / weights.sum(1, keepdim=True)


def _tracks(centres: Tensor, dynamics: Dynamics) -> Tensor:
    levels = torch.linspace(0.0, 1.0, LEVELS, dtype=torch.float64)
    every = Dynamics(*(each.expand(LEVELS, *each.shape[1:]) for each in dynamics))
    return from_diastole(centres.expand(LEVELS, -1, -1), every, levels)


def nominal_targets(hearts: list[Heart]) -> Pose:
    """Return the (K, V) nominal poses of hearts, float64."""
    return Pose(
        torch.stack([heart.found.pose.position for heart in hearts]),
        torch.stack([heart.found.pose.rotation for heart in hearts]),
    )
