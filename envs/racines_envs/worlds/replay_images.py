"""The backend `replay`: the recorded frame nearest to the pose, its image and what was felt there.

Nothing is drawn. Where nobody has been, the nearest frame may be far: `out_of_support` says so.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.store.frames import FrameStore
from racines_envs.worlds.pose_index import PoseIndex, spacing

if TYPE_CHECKING:
    from racines_data.phantom.config import PhantomConfig

QUANTILE = 0.99
"""Out of support is farther from every recorded frame than 99 % of frames are from the nearest of
another trajectory."""


class Replay:
    """Shows the recorded frames of one split of a dataset; an `ImageSource` that feels, too.

    Raises:
        RacinesError: a dataset without poses, or without frames in the split.
    """

    def __init__(
        self, store: FrameStore, device: torch.device | str = "cpu", split: str = "train"
    ) -> None:
        first, last = store.bounds(split)
        if first == last:
            raise RacinesError(f"{store.root}: split {split!r} has no frames to replay")
        self.store, self.split, self.rows = store, split, slice(first, last)
        parameters = store.parameters[self.rows]
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
