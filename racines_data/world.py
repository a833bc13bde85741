# pyright: strict
"""What is scanned: what an environment, an evaluation or a study asks of it.

The phantom is one implementation, recordings in its place are another. A class of your own inherits
`World`, gives its labels, workspace and first three methods, and may leave the rest as it is.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from racines_data.geometry import Pose, parameters_to_pose

if TYPE_CHECKING:
    from racines_data.phantom.config import PhantomConfig

STEP_SECONDS = 0.1
"""What one step of an environment takes where hearts beat, and from frame to frame of patients."""
LONGEST = 60.0
"""An episode, or a sweep, begins so late in a patient's rhythm at most, s."""


def breathed(sway: Tensor, phase: Tensor) -> Tensor:
    """Return the (B, 3) shifts of hearts at (B,) respiratory phases in [0, 1); 0 breathed out.

    `sway` has the shifts at full breath.
    """
    return sway * (0.5 - 0.5 * torch.cos(2.0 * torch.pi * phase)).unsqueeze(1)


@dataclass(frozen=True)
class Workspace:
    """Where the tip may be and how far the probe may lean and turn."""

    position_min: Tensor
    """(3,) m."""
    position_max: Tensor
    tilt_max: float
    yaw_max: float

    def contains(self, pose: Pose) -> Tensor:
        """Return (B,) bool."""
        inside = (pose.position >= self.position_min) & (pose.position <= self.position_max)
        upright = -pose.rotation[:, 2, 2] >= cosine(self.tilt_max)
        yaw = torch.atan2(pose.rotation[:, 1, 0], pose.rotation[:, 0, 0]).abs() <= self.yaw_max
        return inside.all(-1) & upright & yaw


@lru_cache(maxsize=64)
def cosine(angle: float) -> float:
    """Return a cosine as float32 has it."""
    return torch.cos(torch.tensor(angle)).item()


class Truth(NamedTuple):
    """What an oracle, or a recording's labels, say of (B,) poses."""

    view: Tensor
    """(B,) int64 label; Random where no view is attained."""
    grade: Tensor
    """(B,) float32, 1-10 for a view, 0 for Random."""
    membership: Tensor
    """(B, V) float32 in 0-1, how far each view is attained; above 0.5 it is."""
    view_grade: Tensor
    """(B, V) float32 0-10, the grade as each view."""
    clarity: Tensor
    """(B,) float32 in 0-1: coupling over the sector."""
    visibility: Tensor
    """(B, structures) float32 in 0-1."""


@runtime_checkable
class World(Protocol):
    """Knows what is true at a pose, what is felt and seen there, and where the probe may go."""

    views: tuple[str, ...]
    """Names of the views that can be targets."""
    labels: tuple[str, ...]
    """The views, then `Random`."""
    workspace: Workspace

    def target(self, view: str) -> Pose:
        """Return the nominal pose of a view, a batch of one; `RacinesError` if it has none."""
        ...

    def judge(self, pose: Pose) -> Truth:
        """Return the truth of (B,) poses, unchecked."""
        ...

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force, N, and torque, N·m, in the probe's axes, at rest by default.

        `velocity` is (B, 6), m/s and rad/s in the base frame.
        """
        ...

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of poses, unchecked; the seeds draw the noise."""
        ...

    def cases(self, seeds: Tensor) -> Tensor:
        """Return (N,) int64: of which of its cases the episodes of (N,) seeds are."""
        return torch.zeros_like(seeds)

    def scene(self, case: Tensor, time: Tensor) -> "World":
        """Return the world of (B,) rows, each of its own case at (B,) float64 seconds.

        All that is asked of a scene is asked of B poses, one a row. A world of one still case is
        its own scene, of any number of rows.
        """
        return self

    def at(self, rows: Tensor) -> "World":
        """Return the scene of (M,) of its rows, in that order and as often as they are named."""
        return self

    def nominal(self, labels: Tensor) -> Pose:
        """Return the (B,) nominal poses of a scene's rows for (B,) labels of views."""
        found = [self.target(self.views[int(label)]) for label in labels]
        return Pose(*(torch.cat(parts) for parts in zip(*found, strict=True)))

    def truth(self, parameters: Tensor) -> Truth:
        """Return the truth of (B, 12) parameters."""
        return self.judge(parameters_to_pose(parameters))

    def judge_alike(self, pose: Pose) -> Truth:
        """Return the truth of poses, each as if it were alone, to the last bit."""
        return self.judge(pose)

    @property
    def config(self) -> "PhantomConfig | None":
        """Settings of a phantom: its block, its probe, its anatomy; None of all else."""
        return None

    @property
    def surface_height(self) -> float | None:
        """Height of the surface that is touched, m; None where there is no contact model."""
        return None

    def own_starts(
        self,
        label: int,
        target: Pose,
        seeds: Tensor,
        distance: tuple[float, float],
        angle: tuple[float, float],
    ) -> Pose | None:
        """Return a start a seed that does not show a label; None: they are drawn around the target.

        `target` is the nominal pose, a batch of one; `distance` is the least and the most from it
        along the top, m, and `angle` likewise, rad. `seeds` are (N,).
        """
        return None

    def own_nearest(self, pose: Pose, label: int, units: tuple[float, float]) -> Pose | None:
        """Return the nearest of (N,) poses that show a label; None: they are searched with `judge`.

        `units` are what counts as one step of shift, m, and of turn, rad.
        """
        return None
