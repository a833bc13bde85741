"""Recordings in memory whose every pose, label and gray level a test has chosen."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.geometry import Pose, pose_to_parameters
from racines_data.store.frames import FrameStore
from racines_data.views import LABELS

DOWN = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
"""A probe that looks straight down."""


class HeldFrames(FrameStore):
    """A store of frames in memory; the gray level of each is its row, modulo 251."""

    def __init__(
        self, position: Tensor, rotation: Tensor | None = None, views: Any = None,
        grades: Any = None, phases: Tensor | None = None, trajectory: Tensor | None = None,
        splits: tuple[int, int] | None = None, **manifest: Any,
    ) -> None:  # fmt: skip
        """Take (N, 3) m, and what else frames have; splits end at the given two rows."""
        count = len(position)
        rotation = DOWN.expand(count, 3, 3) if rotation is None else rotation
        self.parameters = pose_to_parameters(Pose(position, rotation)).float()
        gray = torch.arange(count) % 251
        self.images = gray.to(torch.uint8)[:, None, None].expand(-1, 128, 128).contiguous()
        none = torch.full((count,), -1)
        self.views = none if views is None else torch.as_tensor(views)
        self.grades = torch.full((count,), torch.nan) if grades is None else torch.as_tensor(grades)
        self.phases, self.labels, self.root = phases, LABELS, Path("held")
        self.trajectory_index = none * 0 if trajectory is None else trajectory
        many = int(self.trajectory_index.max()) + 1
        self.trajectories = [f"sweep-{i}" for i in range(many)]
        self.sessions = [f"day-{i % 2}" for i in range(many)]
        self.frame = torch.arange(count)
        self.manifest = {"source": "held", "version": "1.0.0", "digest": "ab" * 32}
        self.manifest |= {"configs": {"frames": {}}, **manifest}
        self.config = "frames"
        first, second = (count, count) if splits is None else splits
        ends = {"train": [0, first], "validation": [first, second], "test": [second, count]}
        self._splits = ends


def line(count: int = 41, spacing: float = 0.002) -> Tensor:
    """Return (count, 3) positions along x."""
    return torch.arange(count)[:, None] * torch.tensor([spacing, 0.0, 0.0])


def corner(leg: int = 30, spacing: float = 0.002) -> Tensor:
    """Return positions along x, along y, and back along x: a way that turns round twice."""
    there = line(leg, spacing)
    up = torch.arange(1, leg)[:, None] * torch.tensor([0.0, spacing, 0.0]) + there[-1]
    back = torch.arange(1, leg)[:, None] * torch.tensor([-spacing, 0.0, 0.0]) + up[-1]
    return torch.cat([there, up, back])
