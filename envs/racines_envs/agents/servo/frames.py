"""What a servo learns from: frames of train patients, and the ways from there to all views.

    start about a view's middle ----- frame, strayed a little ----> nominal pose of that view

A heart is drawn as it lies in several train patients, at no cost but a search for its views there.
Frames of one patient are a shard, a function of the patient, the settings and the world's version
alone. It is kept on disk, for drawing frames costs more than learning from them.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional

from racines_data.digest import recipe_digest
from racines_data.files import read_tensors, write_once
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    rotate,
    rotation_vector,
)
from racines_data.patients.patient import PATIENTS_VERSION, Patient
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient, lie_anew
from racines_data.patients.splits import seeds_of, split_of
from racines_data.randomness import derive, normal, uniform
from racines_envs.task.tiers import LONGEST, middles
from racines_models.networks.servo import SIDE

STREAM = 311
SPREAD, LEAN = 0.055, 0.6
"""Greatest distance, m, and turn, rad, of a way's beginning from the view's middle."""
JITTER, TURN = (0.005, 0.005, 0.0012), 0.08
"""Standard deviations of a frame about the straight way, m and rad: agents take other ways."""
CLOSE = 0.25
"""Share of these that is left at the target: there agents are about to rest."""
FORCE_LIMIT = 20.0  # N, as the tasks'


@dataclass(frozen=True)
class FrameConfig:
    """How a patient's frames are drawn."""

    frames: int = 1_000
    """Frames a patient."""
    places: int = 16
    """Ways in which a patient lies, is examined and moves: their own, and other train patients'.
    A network that sees a heart in one place only learns that place by heart."""
    moving: float = 0.5
    """Share of the frames drawn at a moment of the beat and the breath; the rest are still."""
    nearer: float = 1.6
    """Exponent on a uniform share of the way from target to start: above 1, more frames near the
    target, where an agent has to be exact, than far off."""


class Frames(NamedTuple):
    """N frames."""

    images: Tensor
    """(N, side, side) uint8."""
    ways: Tensor
    """(N, V, 6) float32 to the views' nominal poses, where the heart lies when breathed out: m in
    the probe's axes, and a rotation vector, rad."""
    scores: Tensor
    """(N, V) float32 in 0-1, how completely each view is shown at that moment."""
    grades: Tensor
    """(N, V) float32, a tenth of its grade."""


def shrink(images: Tensor, side: int = SIDE) -> Tensor:
    """Return (N, side, side) uint8 of (N, 128, 128) uint8: what the network looks at."""
    factor = images.shape[-1] // side
    if factor == 1:
        return images
    small = functional.avg_pool2d(images.unsqueeze(1).float(), factor).round()
    return small.squeeze(1).to(torch.uint8)


def ways_to(pose: Pose, targets: Pose) -> Tensor:
    """Return (N, V, 6) ways from (N,) poses to (N, V) targets, as of `Frames`."""
    inverse = pose.rotation.transpose(-1, -2).unsqueeze(1)
    shift = rotate(inverse, targets.position - pose.position.unsqueeze(1))
    turn = matmul3(inverse.expand_as(targets.rotation), targets.rotation)
    return torch.cat([shift, rotation_vector(turn)], -1)


class Placed(NamedTuple):
    """N probes among a pool's patients, and when."""

    pose: Pose
    rows: Tensor
    """(N,) int64, which of the pool's patients."""
    phase: Tensor
    """(N, 2) of beat and breath."""
    seeds: Tensor
    """(N,) int64, of all chance."""


def place(pool: Pool, rows: Tensor, seeds: Tensor, config: FrameConfig) -> Placed:
    """Place a probe on each of (N,) rows of a pool by (N,) seeds; none where no probe may be."""
    time = uniform(seeds, 1, STREAM)[:, 0].double() * LONGEST
    moving = uniform(seeds, 1, STREAM + 1)[:, 0] < config.moving
    phase = torch.where(moving.unsqueeze(1), pool.phase(rows, time), 0.0)
    pose = draw_poses(pool.targets(rows, phase), seeds, config.nearer)
    allowed = pool.workspace.contains(pose) & (-pool.wrench(pose)[:, 2] <= FORCE_LIMIT)
    pose = Pose(*(part[allowed] for part in pose))
    return Placed(pose, rows[allowed], phase[allowed], seeds[allowed])


def draw_frames(
    pool: Pool, rows: Tensor, seeds: Tensor, config: FrameConfig, side: int = SIDE
) -> Frames:
    """Draw a frame of each of (N,) rows of a pool by (N,) seeds, but where no probe may be."""
    placed = place(pool, rows, seeds, config)
    images = pool.render(placed.pose, placed.rows, placed.phase, derive(placed.seeds, STREAM))
    return Frames(shrink(images, side), *truths(pool, placed))


def truths(pool: Pool, placed: Placed) -> tuple[Tensor, Tensor, Tensor]:
    """Return the ways, scores and grades of `Frames` of what probes see."""
    pose, rows, phase, _ = placed
    shown = pool.scores(pose, rows, phase).float()
    grades = pool.judge(pose, rows, phase).view_grade / 10.0
    return ways_to(pose, pool.targets(rows)), shown, grades


def draw_poses(targets: Pose, seeds: Tensor, nearer: float) -> Pose:
    """Return (N,) poses on the way to one of each row's (N, V) targets, which the seed names."""
    each, u = torch.arange(len(seeds)), uniform(seeds, 8, STREAM + 2)
    label = (u[:, 0] * targets.position.shape[1]).long()
    goal, about = Pose(*(part[each, label] for part in targets)), middles(label)
    aside, round_about = SPREAD * u[:, 1].sqrt(), 2.0 * math.pi * u[:, 2]
    height = -0.002 + 0.006 * u[:, 3]
    shift = torch.stack([aside * round_about.cos(), aside * round_about.sin(), height], -1)
    strayed = normal(seeds, 9, STREAM + 3)
    axis = functional.normalize(strayed[:, 6:], dim=-1)
    begun = matmul3(about.rotation, axis_angle_to_matrix(axis * (LEAN * u[:, 4:5])))
    far = u[:, 5:7] ** nearer
    loose = (CLOSE + far).clamp_max(1.0)
    place = goal.position + (about.position + shift - goal.position) * far[:, :1]
    place = place + strayed[:, :3] * torch.tensor(JITTER) * loose[:, :1]
    turn = rotation_vector(matmul3(goal.rotation.transpose(1, 2), begun))
    turned = axis_angle_to_matrix(turn * far[:, 1:] + strayed[:, 3:6] * TURN * loose[:, 1:])
    return Pose(place, orthonormalise(matmul3(goal.rotation, turned)))


def places_of(patient: int, count: int) -> list[Patient]:
    """Return a patient, then as they would lie in the place of others of the split, by chance."""
    own, split = draw_patient(patient), seeds_of(split_of(patient))
    chance = uniform(derive(torch.tensor([STREAM + 4]), patient), count, STREAM + 4)[0].double()
    others = (chance * len(split)).long().tolist()
    return [own, *(lie_anew(own, draw_patient(split[other])) for other in others[1:])]


def shard(patient: int, config: FrameConfig, folder: Path, side: int = SIDE) -> Frames:
    """Return a patient's frames from the folder, or draw them and put them there."""
    told = {"world": PATIENTS_VERSION, "patient": patient, "side": side, **asdict(config)}

    def draw() -> Frames:
        pool = Pool(places_of(patient, config.places), beating=True)
        seeds = derive(torch.full((config.frames,), STREAM), patient, torch.arange(config.frames))
        return draw_frames(pool, torch.arange(config.frames) % len(pool), seeds, config, side)

    return kept(folder / f"{patient}-{recipe_digest(told)[:16]}.safetensors", draw)


def kept(path: Path, make: Callable[[], Frames]) -> Frames:
    """Return the frames of a file, or make them and put them there.

    Raises:
        RacinesError: a damaged file.
    """
    if not path.is_file():
        made = make()
        columns = {name: column.half() for name, column in made._asdict().items()}
        columns["images"] = made.images
        path.parent.mkdir(parents=True, exist_ok=True)
        write_once(path, lambda part: save_file(columns, part))
    found = read_tensors(path, Frames._fields)
    named = {name: each.float() for name, each in found.items()}
    return Frames(**named | {"images": found["images"]})
