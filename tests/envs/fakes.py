"""A phantom of a few formulae, with the attributes that environments use."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from racines_data.geometry import Pose, euler_to_matrix, geodesic, parameters_to_pose
from racines_data.randomness import sample_seeds, uniform
from racines_data.views import LABELS, RANDOM_LABEL, VIEWS
from racines_data.world import Truth, World
from racines_models.protocol import Judge

ANGLES = torch.tensor(
    [[3.0, 0.1, 0.2], [-2.9, 0.2, -0.3], [3.1, 0.0, 0.5], [2.9, 0.0, 1.0], [3.0, 0.2, 0.9]]
)
PLACES = torch.tensor([[0.47, 0.02], [0.50, 0.01], [0.49, -0.01], [0.51, 0.0], [0.48, 0.02]])


@dataclass(frozen=True)
class FakeWorkspace:
    position_min: Tensor
    position_max: Tensor
    tilt_max: float = 1.0
    yaw_max: float = 2.5

    def contains(self, pose: Pose) -> Tensor:
        inside = (pose.position >= self.position_min) & (pose.position <= self.position_max)
        return inside.all(-1) & (-pose.rotation[:, 2, 2] >= 0.54)


class FakePhantom(World):
    """A view is attained within about 1 cm and 0.4 rad (times `reach`) of its nominal pose."""

    surface_height = 0.065
    views, labels = VIEWS, LABELS

    def __init__(self, reach: float = 1.0) -> None:
        self.reach = reach
        self.workspace = FakeWorkspace(
            torch.tensor([0.412, -0.058, 0.04]), torch.tensor([0.568, 0.068, 0.134])
        )
        self.rendered = 0
        heights = torch.full((len(VIEWS), 1), 0.059)
        self._targets = Pose(torch.cat([PLACES, heights], 1), euler_to_matrix(ANGLES))

    def target(self, view: str) -> Pose:
        row = VIEWS.index(view)
        return Pose(self._targets.position[row : row + 1], self._targets.rotation[row : row + 1])

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        depth = (self.surface_height - pose.position[:, 2]).clamp_min(0.0)
        wrench = torch.zeros(len(depth), 6)
        wrench[:, 2] = -2000.0 * depth
        return wrench

    def judge(self, pose: Pose) -> Truth:
        metres = (pose.position[:, None] - self._targets.position).norm(dim=-1)
        radians = geodesic(pose.rotation[:, None], self._targets.rotation[None])
        badness = ((metres / 0.01).square() + (radians / 0.4).square()) / self.reach**2
        membership = torch.sigmoid((1.5 - badness) * 4.0)
        view_grade = (10.0 - 3.0 * badness).clamp(0.0, 10.0)
        best, view = membership.max(-1)
        grade = view_grade.gather(-1, view.unsqueeze(-1)).squeeze(-1)
        return Truth(
            torch.where(best > 0.5, view, RANDOM_LABEL),
            torch.where(best > 0.5, grade, 0.0),
            membership,
            view_grade,
            torch.ones_like(best),
            torch.ones_like(membership),
        )

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        self.rendered += len(seeds)
        base = (pose.position * 1e4).sum(-1) % 128 + 20
        noise = uniform(seeds, 128 * 128).view(-1, 128, 128) * 64
        return (base.view(-1, 1, 1) + noise).to(torch.uint8)

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        return self.render(parameters_to_pose(parameters), sample_seeds(seed, len(parameters)))


class FakeGrader(Judge):
    """Reads p and g off the image's mean gray level, so that it depends on the image alone."""

    settings: ClassVar[dict[str, Any]] = {"id": "mean-level", "sha256": "ab" * 32}

    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        level = images.float().mean((1, 2)) / 255.0
        probabilities = torch.stack([level] * 6, -1)
        return probabilities, level * 10.0
