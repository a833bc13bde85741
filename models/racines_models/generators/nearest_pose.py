"""Retrieval: the training image whose pose is nearest."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose, pose_keys
from racines_data.store.frames import FrameStore
from racines_models.adapting import check_scout
from racines_models.generators.base import BaseGenerator
from racines_models.networks.layers import on_circle
from racines_models.protocol import Run
from racines_models.sample import evenly

QUERIES = 64
"""Poses compared at a time: bounds the distance matrix at 37 MB for 144,668 frames."""


@dataclass(frozen=True)
class NearestPoseConfig:
    """Metric and size of the memory."""

    metres_per_radian: float = 0.07
    """What a turn weighs against a shift: the depth at which a point moves by as much in both.
    The default is half of the usual 14 cm imaging depth."""
    metres_per_beat: float = 0.5
    """What a beat weighs against a shift, where the data know its phase: the circumference of the
    circle on which phases lie. Half of a beat is then 16 cm away, a sixth 8 cm."""
    frames: int = 0
    """Training frames kept, evenly spread over the split; 0 keeps all."""

    def __post_init__(self) -> None:
        if min(self.metres_per_radian, self.metres_per_beat, self.frames) < 0:
            raise RacinesError(
                "nearest-pose: metres_per_radian, metres_per_beat and frames are 0 or more"
            )


class NearestPose(BaseGenerator[NearestPoseConfig]):
    """Returns the training image of the nearest pose; of equally near ones, the first.

    The distance is sqrt(|Δp|² + (w · 2 sin(θ/2))²) with Δp in metres, θ the angle between the
    rotations and w metres per radian: Euclidean in position and w/√2 times the rotation matrix,
    so the search is one exact batched distance. Where the data know the phase of the beat, the
    chord between two phases on a circle is a further part of it.
    """

    name = "nearest-pose"
    Config = NearestPoseConfig
    title = "Nearest pose"
    summary = "The training image whose probe pose is nearest."
    source = "a floor of this benchmark (under a split by frames it would win)"
    trained = False
    limits = ("draws nothing new", "jumps between neighbouring training frames")
    holds = ("keys", "images")
    scout = 1

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Remember poses and images of the train split, in order of the store."""
        frames = store.split_indices("train").sort().values
        if 0 < self.config.frames < len(frames):
            frames = frames[evenly(len(frames), self.config.frames)]
        kept = store.take(frames)
        memory = {"keys": self.embed(kept.parameters), "images": kept.images}
        self.held = {name: tensor.to(self.device) for name, tensor in memory.items()}
        return {"images": len(frames)}

    def adapt(self, images: Tensor, parameters: Tensor, seed: int) -> "NearestPose":
        """Remember a patient's scout instead (see `Adapting`); nothing has to be fitted before."""
        check_scout(images, parameters, self.scout, self.name)
        other = NearestPose(self.config)
        other.device, other.seed, other.data = self.device, self.seed, self.data
        held = {"keys": self.embed(parameters.float()), "images": images}
        other.held = {name: tensor.to(self.device) for name, tensor in held.items()}
        return other

    def embed(self, parameters: Tensor) -> Tensor:
        """Return (B, 12) keys of (B, 12) parameters: Euclidean distance is that of the poses, m.

        (B, 14) of (B, 13), the last of which is the phase of the beat.
        """
        pose, beat = parameters_to_pose(parameters), parameters[:, 12:]
        pose = Pose(pose.position * self.metres, pose.rotation)
        keys = pose_keys(pose, self.config.metres_per_radian)
        if not beat.shape[1]:
            return keys
        return torch.cat([keys, self.config.metres_per_beat / math.tau * on_circle(beat)], 1)

    def nearest(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Return the (B,) index of the nearest training frame and the (B,) distance, m."""
        found, keys = [], self.held["keys"]
        for queries in self.embed(parameters).split(QUERIES):
            # The exact form, not the matrix product: equal poses have distance 0, and a row's
            # result ignores its batch. argmin returns the first of equal minima.
            distance = torch.cdist(queries, keys, compute_mode="donot_use_mm_for_euclid_dist")
            index = distance.argmin(1)
            found.append((index, distance.gather(1, index[:, None]).squeeze(1)))
        index, distance = (torch.cat(column) for column in zip(*found, strict=True))
        return index, distance

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) images of the nearest poses."""
        return self.held["images"][self.nearest(parameters)[0]]
