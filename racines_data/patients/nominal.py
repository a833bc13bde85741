"""The nominal poses of a patient's views, found by what the oracle sees from them.

The planes that the shape gives are where a search begins; ribs, the tilt of the chest and a
pathology move the best place away from there. A beating heart's nominal pose is good over the
whole beat: the worst moment counts most.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise
from racines_data.patients.chest import Chest
from racines_data.patients.draws import exact_normal
from racines_data.patients.oracle import completeness, look
from racines_data.patients.placement import REACH, SURFACE, TILT_MAX
from racines_data.patients.settings import Settings
from racines_data.phantom.config import ContactConfig, WorkspaceConfig
from racines_data.phantom.truth import deepest
from racines_data.randomness import sample_seeds

ROUNDS, CANDIDATES = 10, 40
FIRST = (0.008, 0.008, 0.0015, 0.10, 0.10, 0.08)
"""Spread of the first round's candidates: position, m, and turns about the probe's axes, rad."""
SHRINK = 0.74  # of the spread, from round to round
AWAY = 0.020, 0.30
"""Distance, m, and turn, rad, from the shape's own pose at which the search is reined in."""


class Scene(NamedTuple):
    """One patient, as a search sees it."""

    marks: Tensor  # (A, S, 3) landmarks at some moments of the beat, mm, base frame
    radii: Tensor  # (S,) mm
    weights: Tensor  # (V, S)
    settings: Settings  # one row
    chest: Chest  # one row


class Found(NamedTuple):
    """What a search found."""

    pose: Pose  # (V,) float64
    score: Tensor  # (V,) completeness at the worst moment
    clarity: Tensor  # (V,)


def find_poses(start: Pose, scene: Scene, seed: int) -> Found:
    """Search the best pose of each view around (V,) starts."""
    views = len(start.position)
    spread = torch.tensor(FIRST, dtype=torch.float64)
    best = Pose(start.position.clone(), start.rotation.clone())
    for turn in range(ROUNDS):
        draw = exact_normal(sample_seeds(seed * 64 + turn, views), CANDIDATES * 6, 19)
        move = draw.round(decimals=6).view(views, CANDIDATES, 6) * spread * SHRINK**turn
        move[:, 0] = 0.0  # what is best so far stays in the field
        tried = _moved(best, move)
        value = _value(tried, start, scene)
        row = value.argmax(1)
        each = torch.arange(views)
        best = Pose(tried.position[each, row], tried.rotation[each, row])
    best = Pose(best.position.round(decimals=6), orthonormalise(best.rotation.round(decimals=7)))
    alone = Pose(best.position.unsqueeze(1), best.rotation.unsqueeze(1))
    complete, clarity = _seen(alone, scene)
    return Found(best, complete.amin(0)[:, 0], clarity.amin(0)[:, 0])


def _moved(pose: Pose, move: Tensor) -> Pose:
    """Return (V, N) poses, each held within the workspace and the force that is allowed."""
    position = pose.position.unsqueeze(1) + move[..., :3]
    low = position.new_tensor(REACH[0])
    low[2] = deepest(0.8 * WorkspaceConfig().press, SURFACE, ContactConfig())
    high = position.new_tensor((*REACH[1][:2], SURFACE - 0.003))
    position = torch.minimum(torch.maximum(position, low), high)
    turned = matmul3(pose.rotation.unsqueeze(1), axis_angle_to_matrix(move[..., 3:]))
    return Pose(position, turned)


def _seen(pose: Pose, scene: Scene) -> tuple[Tensor, Tensor]:
    """Return (A, V, N) completeness of each view at its own candidates, and their clarity."""
    moments, (views, count) = len(scene.marks), pose.position.shape[:2]
    total = views * count
    flat = Pose(pose.position.reshape(total, 3), pose.rotation.reshape(total, 3, 3))
    rows = torch.zeros(total, dtype=torch.int64)
    settings, chest = scene.settings.rows(rows), scene.chest.rows(rows)
    complete: list[Tensor] = []
    clarity: list[Tensor] = []
    view = torch.arange(views).repeat_interleave(count).view(-1, 1)
    for moment in range(moments):
        marks = scene.marks[moment].expand(total, -1, -1)
        sight = look(flat, marks, scene.radii, settings, chest)
        every = completeness(sight.visibility, scene.weights)
        complete.append(every.gather(1, view).view(views, count))
        clarity.append(sight.clarity.view(views, count))
    return torch.stack(complete), torch.stack(clarity)


def _value(pose: Pose, start: Pose, scene: Scene) -> Tensor:
    """Return (V, N) how good candidates are."""
    complete, clarity = _seen(pose, scene)
    score = 0.6 * complete.amin(0) + 0.4 * complete.mean(0)
    score = score + 0.15 * clarity.mean(0).clamp_max(0.95)
    away = (pose.position - start.position.unsqueeze(1)).norm(dim=-1) / AWAY[0]
    chord = (pose.rotation - start.rotation.unsqueeze(1)).square().sum((-2, -1))
    chord = chord / (2.0 * AWAY[1] ** 2)
    lean = (-pose.rotation[..., 2, 2] < torch.cos(torch.tensor(TILT_MAX - 0.02)).item()).double()
    return score - 0.02 * (away.square() + chord) - lean
