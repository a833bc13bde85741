"""What an image agent learns before any reward: to tell where the probe is, anywhere that tasks go.

The dataset's sweeps pass through views; the tasks start 25 to 55 mm and up to 0.7 rad away from
them, where a regressor of the dataset's poses is lost. Here frames are drawn in the environment
itself, between the starts of all tasks and their nominal poses, and a network learns to read the
pose back from the image. The true pose is told in this training alone (Pinto et al., Asymmetric
Actor Critic for Image-Based Robot Learning, 2018, use the simulator's state in the same way); the
agent that looks through the network is given images only.
"""

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    pose_to_parameters,
    rotation_vector,
)
from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.anatomy import anatomy_views
from racines_data.randomness import derive, normal, uniform
from racines_data.schema import SPLITS
from racines_data.store.frames import BatchMemory, FrameStore
from racines_data.views import HEART, labels_of
from racines_data.world import World
from racines_envs.task.starts import draw_starts
from racines_envs.task.tasks import Task, get_task
from racines_envs.worlds.backends import open_source, source_weights
from racines_envs.worlds.making import WorldLike, make_phantom, phantom_recipe
from racines_models.judges.pose.regressor import PoseConfig, PoseTraining
from racines_models.judges.pose.training import train_pose
from racines_models.protocol import Run

CHUNK = 512  # frames drawn at once
STREAM = 211
NEARER = 0.7
"""Exponent on a uniform share of the way from target to start: more frames far off than near."""
JITTER, TURN = (0.004, 0.004, 0.0015), 0.05
"""Standard deviations of a frame about the straight way, m and rad: agents take other ways."""
TRAIN, VALIDATION = 0.95, 0.975
"""Where the splits end, as shares of the frames."""


@dataclass(frozen=True)
class ExplorationConfig:
    """How many frames, and the network that reads them."""

    frames: int = 60_000
    """Frames drawn, of all tasks alike; those outside the workspace are left out."""
    anatomy: str = HEART
    generator: str = ""
    """Who draws the images of these poses, as for the backend `generator`; the phantom if empty."""
    pose: PoseConfig = PoseConfig(training=PoseTraining(images=480_000))

    def __post_init__(self) -> None:
        if self.frames < 200:
            raise RacinesError(f"encoder.frames is {self.frames}: give 200 or more")


class ExploredFrames(FrameStore):
    """Frames drawn in the environment, in memory; split by frame, for no two are neighbours."""

    def __init__(self, parameters: Tensor, images: Tensor, labels: Any, manifest: dict[str, Any]):
        """Take (N, 12) parameters and (N, 128, 128) images, in random order."""
        count = len(parameters)
        self.parameters, self.images, self.manifest = parameters, images, manifest
        self.views = torch.zeros(count, dtype=torch.int64)
        self.grades = torch.full((count,), torch.nan)
        self.trajectory_index = torch.arange(count)
        self.labels = labels
        self._memory, self._words = BatchMemory(), images.flatten(1).view(torch.int64)
        ends = [0, int(TRAIN * count), int(VALIDATION * count), count]
        self._splits = {name: ends[i : i + 2] for i, name in enumerate(SPLITS)}


def explore(config: ExplorationConfig, phantom: World, seed: int) -> ExploredFrames:
    """Draw frames of poses between the starts and the targets of all tasks of an anatomy.

    The seed is of poses and electronic noise.
    """
    source = open_source(config.generator) if config.generator else None
    views = anatomy_views(config.anatomy)
    seeds = derive(torch.full((config.frames,), STREAM), seed, torch.arange(config.frames))
    parameters, images = [], []
    for row, chunk in enumerate(seeds.split(CHUNK)):
        pose = _between(get_task(views[row % len(views)], config.anatomy), phantom, chunk)
        inside = phantom.workspace.contains(pose)
        pose, chunk = Pose(*(part[inside] for part in pose)), chunk[inside]
        told = pose_to_parameters(pose, phantom.wrench(pose))
        drawn = phantom.render(pose, chunk) if source is None else source.generate(told, chunk)
        images.append(drawn.view(-1, IMAGE_SIZE, IMAGE_SIZE))
        parameters.append(told)
    order = torch.randperm(sum(map(len, images)), generator=torch.Generator().manual_seed(seed))
    recipe = {"phantom": phantom_recipe(phantom), "frames": config.frames, "seed": seed}
    if source is not None:
        recipe |= {"generator": source_weights(config.generator)}
    manifest = {"source": "exploration", "version": None, "digest": None, "recipe_digest": recipe}
    columns = torch.cat(parameters)[order], torch.cat(images)[order]
    return ExploredFrames(*columns, labels_of(views), manifest)


def _between(task: Task, phantom: World, seeds: Tensor) -> Pose:
    """Return a pose a seed on the straight way from a start of the task to its nominal pose."""
    target = phantom.target(task.view)
    start = draw_starts(task, phantom, target, seeds)
    shares = uniform(derive(seeds, STREAM), 2) ** NEARER
    jitter = normal(derive(seeds, STREAM, 1), 6)
    place = target.position + (start.position - target.position) * shares[:, :1]
    place = place + jitter[:, :3] * torch.tensor(JITTER)
    nominal = target.rotation.expand(len(seeds), -1, -1)
    turn = rotation_vector(matmul3(nominal.transpose(1, 2), start.rotation))
    turned = axis_angle_to_matrix(turn * shares[:, 1:] + jitter[:, 3:] * TURN)
    return Pose(place, orthonormalise(matmul3(nominal, turned)))


def train_encoder(config: ExplorationConfig, run: Run, phantom: WorldLike = None) -> dict[str, Any]:
    """Explore, train, save into `run.folder`; return the metrics on the held-out frames.

    A killed run draws the same frames again and goes on from its checkpoint.
    """
    world = make_phantom(phantom, "cpu", config.anatomy)
    store = explore(config, world, run.seed)
    metrics = train_pose(store, config.pose, run)
    metrics["exploration"] = asdict(config) | {"kept": len(store.parameters)}
    write_json(run.folder / "metrics.json", metrics)
    return metrics
