"""What a servo with a memory notes of each image, and where it was taken."""

from dataclasses import dataclass

import torch
from torch import Tensor

from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    rotation_vector,
)
from racines_envs.task.tiers import middles
from racines_models.networks.recall import LIES, TOKEN

LONGEST = 200
"""Steps of an episode that are noted: all that a task on patients has."""


def lies(pose: Pose, labels: Tensor) -> Tensor:
    """Return (N, 6) where (N,) poses lie about the middles of (N,) labels, in `LIES`."""
    about = middles(labels)
    turn = rotation_vector(matmul3(about.rotation.transpose(1, 2).contiguous(), pose.rotation))
    return torch.cat([pose.position - about.position, turn], 1) / _scale(labels)


def pose_at(lying: Tensor, labels: Tensor) -> Pose:
    """Return the (N,) poses that lie so."""
    about, where = middles(labels), lying * _scale(labels)
    turned = matmul3(about.rotation, axis_angle_to_matrix(where[:, 3:]))
    return Pose(about.position + where[:, :3], orthonormalise(turned))


def _scale(like: Tensor) -> Tensor:
    return torch.tensor(LIES, device=like.device)


@dataclass
class Notes:
    """Of N rows."""

    tokens: Tensor
    """(N, LONGEST, TOKEN), see `RecallNetwork`."""
    seen: Tensor
    """(N, LONGEST) bool, which there are."""

    @classmethod
    def new(cls, count: int, device: torch.device) -> "Notes":
        """Begin with nothing."""
        tokens = torch.zeros(count, LONGEST, TOKEN, device=device)
        return cls(tokens, torch.zeros(count, LONGEST, dtype=torch.bool, device=device))

    def take(self, tokens: Tensor, steps: Tensor, same: Tensor) -> None:
        """Note (N, TOKEN) tokens at (N,) steps; rows that are not the same episodes begin anew."""
        self.seen &= same.unsqueeze(1)
        row = torch.arange(len(steps), device=steps.device)
        place = steps.clamp_max(LONGEST - 1)
        self.tokens[row, place] = tokens
        self.seen[row, place] = True
