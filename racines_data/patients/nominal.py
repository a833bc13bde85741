"""The nominal poses of a patient's views, found by what the oracle sees from them.

The planes that the shape gives are where a search begins; ribs, the tilt of the chest and a
pathology move the best place away from there. A beating heart's nominal pose is good over the
whole beat: the worst moment counts most.

The search is an evolution strategy whose covariance adapts (rank-mu update: Hansen, Müller and
Koumoutsakos, 2003): around a view's best pose some directions cost little, and one that shrinks
the same in all of them stops anywhere along these, millimetres from where it stops the next time.
"""

import math
from functools import lru_cache
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

ROUNDS, CANDIDATES, CHOSEN = 24, 32, 8
WIDE, MANY = 3, 256
"""Rounds at the start that try many: a view may show through two spaces between ribs."""
MIX = 0.5
"""Share of the covariance that each round's chosen candidates make."""
FIRST = (0.008, 0.008, 0.0015, 0.10, 0.10, 0.08)
"""Spread of the first round's candidates: position, m, and turns about the probe's axes, rad."""
AWAY = 0.020, 0.30
"""Distance, m, and turn, rad, from the shape's own pose that cost as much as `REINED`."""
REINED = 0.1
"""Of completeness: enough to choose among poses that show the same, such as short-axis ones."""
STREAM = 19


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


def find_poses(start: Pose, scene: Scene, stream: int = STREAM) -> Found:
    """Search the best pose of each view around (V,) starts, with the same draws for everyone."""
    views = len(start.position)
    unit = torch.tensor(FIRST, dtype=torch.float64)
    weights = math.log(CHOSEN + 0.5) - torch.arange(1.0, CHOSEN + 1.0, dtype=torch.float64).log()
    weights = (weights / weights.sum()).unsqueeze(1)
    best, covariance = start, torch.eye(6, dtype=torch.float64).expand(views, 6, 6)
    for draw in _draws(views, stream):
        move = draw @ torch.linalg.cholesky(covariance).transpose(-1, -2)
        value = _value(_moved(best, move * unit), start, scene)
        top = value.topk(CHOSEN, dim=1).indices.unsqueeze(-1).expand(-1, -1, 6)
        chosen = move.gather(1, top)
        # About the old mean, not the new one: along a slope the spread grows.
        spread = (chosen * weights).transpose(1, 2) @ chosen
        covariance = (1.0 - MIX) * covariance + MIX * spread + 1e-8 * torch.eye(6).double()
        mean = (chosen * weights).sum(1, keepdim=True) * unit
        best = Pose(*(each.squeeze(1) for each in _moved(best, mean)))
        best = Pose(best.position, orthonormalise(best.rotation))
    best = Pose(best.position.round(decimals=6), orthonormalise(best.rotation.round(decimals=7)))
    alone = Pose(best.position.unsqueeze(1), best.rotation.unsqueeze(1))
    complete, clarity = _seen(alone, scene)
    return Found(best, complete.amin(0)[:, 0], clarity[:, 0])


@lru_cache(maxsize=1)
def _draws(views: int, stream: int) -> list[Tensor]:
    """Return what the rounds draw, (V, N, 6) each."""
    drawn: list[Tensor] = []
    for turn in range(ROUNDS):
        count = MANY if turn < WIDE else CANDIDATES
        normal = exact_normal(sample_seeds(turn, views), count * 6, stream)
        drawn.append(normal.round(decimals=6).view(views, count, 6))
    return drawn


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
    """Return (A, V, N) completeness of each view at its own candidates, and (V, N) clarity."""
    (moments, marks), (views, count) = scene.marks.shape[:2], pose.position.shape[:2]
    total = views * count
    flat = Pose(pose.position.reshape(total, 3), pose.rotation.reshape(total, 3, 3))
    rows = torch.zeros(total, dtype=torch.int64)
    settings, chest = scene.settings.rows(rows), scene.chest.rows(rows)
    # Ribs and lung are the same at all moments, so they are looked through once.
    every = scene.marks.flatten(0, 1).expand(total, -1, -1)
    sight = look(flat, every, scene.radii.repeat(moments), settings, chest)
    visibility = sight.visibility.view(views, count, moments, marks)
    complete = completeness(visibility, scene.weights[:, None, None])
    return complete.permute(2, 0, 1), sight.clarity.view(views, count)


def _value(pose: Pose, start: Pose, scene: Scene) -> Tensor:
    """Return (V, N) how good candidates are."""
    complete, clarity = _seen(pose, scene)
    score = 0.6 * complete.amin(0) + 0.4 * complete.mean(0) + 0.15 * clarity.clamp_max(0.95)
    away = (pose.position - start.position.unsqueeze(1)).norm(dim=-1) / AWAY[0]
    chord = (pose.rotation - start.rotation.unsqueeze(1)).square().sum((-2, -1))
    chord = chord / (2.0 * AWAY[1] ** 2)
    lean = (-pose.rotation[..., 2, 2] < math.cos(TILT_MAX - 0.02)).double()
    return score - REINED * (away.square() + chord) - lean
