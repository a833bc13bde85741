"""The nearest of many recorded poses, by the distance of the generator `nearest-pose`."""

import torch
from scipy.spatial import KDTree
from torch import Tensor

from racines_data.geometry import Pose, pose_to_parameters
from racines_models.generators.nearest_pose import NearestPose, NearestPoseConfig

SAMPLE = 512
"""Poses whose nearest neighbour in another trajectory says how far apart recordings lie."""


class PoseIndex:
    """M recorded poses that can be searched.

    The distance is that of `racines_models.generators.nearest_pose`, in metres: a shift, and a turn
    at 0.07 m a radian. On the CPU a k-d tree over its keys is searched (25 times quicker over
    101,314 frames), on an accelerator all keys at once, as that generator does. A pose's answer
    ignores its batch.
    """

    def __init__(self, parameters: Tensor, device: torch.device | str = "cpu") -> None:
        """Remember the poses of (M, 12) parameters."""
        self._search = NearestPose(NearestPoseConfig())
        keys = self._search.embed(parameters)
        self._tree = KDTree(keys.numpy()) if torch.device(device).type == "cpu" else None
        self._search.keys = keys.to(device)

    def nearest(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Return the (B,) int64 index of the nearest of them and its (B,) distance, m."""
        if self._tree is None:
            return self._search.nearest(parameters)
        distance, index = self._tree.query(self._search.embed(parameters).numpy())
        return torch.from_numpy(index), torch.from_numpy(distance).to(torch.float32)

    def nearest_to(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return the same of (B,) poses."""
        return self.nearest(pose_to_parameters(pose))


def spacing(parameters: Tensor, trajectory: Tensor, quantile: float) -> float:
    """Return how far apart, m, recordings of one place lie: a quantile over a sample of frames.

    Of 512 frames, evenly spread, the distance to the nearest frame of another trajectory: those of
    its own lie millimetres away and say nothing about where else the probe has been. Of a single
    trajectory, to its nearest other frame.

    Args:
        parameters: (M, 12), on the CPU.
        trajectory: (M,) int64, whose frame each is.
        quantile: In 0-1.
    """
    count = len(parameters)
    rows = torch.arange(min(count, SAMPLE)) * count // min(count, SAMPLE)
    keys = NearestPose(NearestPoseConfig()).embed(parameters)
    single = bool((trajectory == trajectory[0]).all())
    found = []
    for some in rows.split(64):
        distance = torch.cdist(keys[some], keys, compute_mode="donot_use_mm_for_euclid_dist")
        own = torch.arange(count) if single else trajectory
        distance[own[some][:, None] == own[None]] = torch.inf
        found.append(distance.amin(1))
    distances = torch.cat(found)
    return float(distances.quantile(quantile)) if count > 1 else 0.0
