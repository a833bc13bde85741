"""The nearest of many recorded poses, for batches.

A pose is a point, its key: the position, and the rotation matrix scaled so that the Euclidean
distance of two keys is that of the poses (`racines_data.geometry.pose_keys`). A cardiac phase adds
a point on a circle, as phases 0.98 and 0.02 are near.
"""

import math

import torch
from scipy.spatial import KDTree
from torch import Tensor

QUERIES = 16
"""Keys compared with all recorded ones at once on an accelerator: bounds the memory."""


class Nearest:
    """Searches M keys.

    On the CPU a k-d tree over them is searched (25 times quicker over 101,314 frames), on an
    accelerator all keys at once. The answer to a key ignores its batch.
    """

    def __init__(self, keys: Tensor, device: torch.device | str = "cpu") -> None:
        """Take (M, K) float32 keys."""
        self.keys = keys.to(device)
        self._tree = KDTree(keys.cpu().numpy()) if self.keys.device.type == "cpu" else None

    def __call__(self, keys: Tensor) -> tuple[Tensor, Tensor]:
        """Return the (B,) int64 index of the nearest to (B, K) keys, and its (B,) distance."""
        index, distance = self.several(keys, 1)
        return index.squeeze(1), distance.squeeze(1)

    def several(self, keys: Tensor, count: int) -> tuple[Tensor, Tensor]:
        """Return the (B, count) indices of the nearest, near ones first, and their distances.

        `count` is at most M.
        """
        if self._tree is not None:
            found = self._tree.query(keys.numpy(), k=count)
            distance, index = (torch.from_numpy(x).view(-1, count) for x in found)
            return index, distance.to(torch.float32)
        parts = []
        for queries in keys.split(QUERIES):
            # The exact form, not the matrix product: equal keys have distance 0, and a row's
            # result ignores its batch.
            away = torch.cdist(queries, self.keys, compute_mode="donot_use_mm_for_euclid_dist")
            distance, index = away.topk(count, largest=False)
            parts.append((index, distance))
        index, distance = (torch.cat(column) for column in zip(*parts, strict=True))
        return index, distance


def phase_keys(phase: Tensor, weight: float) -> Tensor:
    """Return (B, 2) points on a circle of (B,) phases in [0, 1); half a beat is `weight` apart."""
    angle = 2.0 * math.pi * phase
    return 0.5 * weight * torch.stack([angle.cos(), angle.sin()], -1).float()
