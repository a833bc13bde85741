"""A small dataset of sweeps over smooth pictures that follow the pose, in memory."""

from pathlib import Path

import torch

from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    pose_to_parameters,
    rotate,
)
from tests.models.conftest import FakeStore, pictures

LENGTH = 8
"""Frames of a sweep."""
SWEEPS = {"train": 30, "validation": 4, "test": 6}
DOWN = torch.diag(torch.tensor([1.0, -1.0, -1.0]))


def sweep_parameters(seed: int, length: int = LENGTH) -> torch.Tensor:
    """Return (length, 12) parameters of a probe that drifts and turns, a little anew each step."""
    generator = torch.Generator().manual_seed(seed)
    scale = torch.tensor([0.012, 0.012, 0.004, 0.02, 0.02, 0.15])
    vectors = torch.randn(length, 6, generator=generator) * scale
    start = torch.tensor([0.49, 0.0, 0.06]) + 0.01 * torch.randn(3, generator=generator)
    position, rotation = [start], [DOWN]
    for step in vectors[1:]:
        position.append(position[-1] + rotate(rotation[-1], step[:3]))
        rotation.append(matmul3(rotation[-1], axis_angle_to_matrix(step[3:])))
    return pose_to_parameters(Pose(torch.stack(position), torch.stack(rotation))).float()


class SweptStore(FakeStore):
    """Sweeps of the phantom, whose pixels are known by its recipe."""

    def __init__(self, sweeps: dict[str, int] | None = None, length: int = LENGTH) -> None:
        super().__init__(train=8)
        counts = sweeps or SWEEPS
        total = sum(counts.values())
        self.parameters = torch.cat([sweep_parameters(seed, length) for seed in range(total)])
        self.images = pictures(self.parameters)
        count = len(self.images)
        self.root, self.config = Path("data/racines"), "frames"
        self.views = torch.zeros(count, dtype=torch.int64)
        self.grades = torch.full((count,), 5.0)
        self.timestamps = torch.arange(count, dtype=torch.float64) / 10
        self.trajectory_index = torch.arange(count) // length
        self.trajectories = [f"{place:05d}-a4c" for place in range(total)]
        self.sessions = [f"session-{place // 4}" for place in range(total)]
        self.phantoms = [0] * total
        ends = torch.tensor([0, *counts.values()]).cumsum(0) * length
        self._splits = {name: [int(ends[i]), int(ends[i + 1])] for i, name in enumerate(counts)}
        self.manifest = dict(self.manifest, recipe={"settings": {}})


def recorded(store: SweptStore) -> SweptStore:
    """Make a store one of recordings, of which nobody says where pixels lie."""
    store.phantoms = [None] * len(store.trajectories)
    store.manifest = dict(store.manifest, source="tracked")
    return store
