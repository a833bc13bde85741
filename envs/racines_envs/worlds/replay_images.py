"""The backend `replay`: the recorded frame nearest to the pose, its image and what was felt there.

Nothing is drawn. Where nobody has been, the nearest frame may be far: `out_of_support` says so.
"""

from typing import TYPE_CHECKING

import torch
from scipy.spatial import KDTree
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.store.frames import FrameStore
from racines_models.generators.nearest_pose import NearestPose

if TYPE_CHECKING:
    from racines_data.phantom.config import PhantomConfig

QUANTILE = 0.99
"""Out of support is farther from every recorded frame than 99 % of frames are from the nearest of
another trajectory."""
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
        self._search = NearestPose()
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
    """Return how far apart, m, recordings of one place lie: a quantile in 0-1 over some frames.

    Of 512 of (M, 12), evenly spread, the distance to the nearest frame of another of their (M,)
    trajectories: those of its own lie millimetres away and say nothing about where else the probe
    has been. Of a single trajectory, to its nearest other frame. All on the CPU.
    """
    count, sample = len(parameters), min(len(parameters), SAMPLE)
    if count == 1:
        return 0.0
    keys = NearestPose().embed(parameters)
    own = torch.arange(count) if bool((trajectory == trajectory[0]).all()) else trajectory
    found = []
    for rows in (torch.arange(sample) * count // sample).split(64):
        distance = torch.cdist(keys[rows], keys, compute_mode="donot_use_mm_for_euclid_dist")
        distance[own[rows][:, None] == own[None]] = torch.inf
        found.append(distance.amin(1))
    return float(torch.cat(found).quantile(quantile))


class Replay:
    """Shows the recorded frames of one split of a dataset; an `ImageSource` that feels, too.

    Raises:
        RacinesError: a dataset without poses, or without frames in the split.
    """

    def __init__(
        self, store: FrameStore, device: torch.device | str = "cpu", split: str = "train"
    ) -> None:
        self.store, self.split, self.rows = store, split, slice(*store.bounds(split))
        parameters = store.parameters[self.rows]
        if not len(parameters):
            raise RacinesError(f"{store.root}: split {split!r} has no frames to replay")
        if not bool(torch.isfinite(parameters[:, 6:]).all()):
            raise RacinesError(
                f"{store.root}: frames without poses ({store.manifest['source']}) cannot be "
                "replayed: give a dataset of poses and images"
            )
        self.index = PoseIndex(parameters, device)
        self.threshold = spacing(parameters, store.trajectory_index[self.rows], QUANTILE)
        """Distance, m, from which on a pose is out of support."""
        self.parameters = parameters.to(device)
        self.images = store.images[self.rows].to(device)
        # A force that was not measured is none.
        self._wrench = torch.nan_to_num(self.parameters[:, :6])

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return the (B, 128, 128) images recorded nearest to (B, 12) parameters; no seed."""
        return self.images[self.index.nearest(parameters)[0]]

    def wrench(self, pose: Pose) -> Tensor:
        """Return the (B, 6) wrench recorded nearest to poses, N and N·m; 0 where not measured."""
        return self._wrench[self.index.nearest_to(pose)[0]]

    def out_of_support(self, parameters: Tensor) -> Tensor:
        """Return (B,) bool: no frame was recorded near (B, 12) parameters."""
        return self.index.nearest(parameters)[1] > self.threshold


def source_phantom(store: FrameStore) -> "PhantomConfig | None":
    """Return the configuration of the phantom that a dataset was acquired from; None if of none."""
    if store.manifest["source"] != "phantom":
        return None
    from racines_data.config import fill
    from racines_data.phantom import PhantomConfig

    settings = store.manifest.get("recipe", {}).get("settings", {})
    values = settings.get("acquisition", {}).get("phantom", {})
    return fill(PhantomConfig, values, f"{store.root}/manifest.json: phantom")
