"""The informed upper bound: it knows the nominal pose, and goes there greedily."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic
from racines_envs.agents.protocol import Untrained
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import is_hit


@dataclass(frozen=True)
class PlannerConfig:
    """Nothing to set."""


class PlannerAgent(Untrained):
    """Takes the step that most reduces the distance to the nominal pose; idles on a hit.

    The distance is |Δp|²/u² + θ²/w² with the unit steps u and w, so the axis with most unit steps
    left goes first. Steps that the limits would refuse are left out.
    """

    name: ClassVar[str] = "planner"
    Config: ClassVar[type] = PlannerConfig
    sees: ClassVar[str] = "truth"

    def __init__(self) -> None:
        self._core: ScanCore | None = None

    def attach(self, core: ScanCore) -> None:
        """Keep the environment: this agent is told the pose, its target and the oracle's score."""
        self._core = core

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Compare all thirteen steps of every row, (N × 13) poses at once."""
        core = self._core
        if core is None:
            raise RacinesError("the planner needs the environment: call attach(core) first")
        count, options = core.num_envs, len(ACTIONS)
        position, rotation = core.state.pose
        each = Pose(position.repeat_interleave(options, 0), rotation.repeat_interleave(options, 0))
        action = torch.arange(options, device=core.device).repeat(count)
        moved = core.table.move(each, action)
        force = core.state.force.repeat_interleave(options)
        inside, soft = core.limits(moved, core.wrench(moved), force)
        cost = torch.where(inside & soft, self._distance(core, moved), torch.inf)
        best = cost.view(count, options).argmin(1)
        arrived = is_hit(core.score, core.rewards) & is_hit(core.scored_by("oracle"), core.rewards)
        return torch.where(arrived, IDLE, best)

    @staticmethod
    def _distance(core: ScanCore, pose: Pose) -> Tensor:
        metres = (pose.position - core.target.position).norm(dim=-1)
        radians = geodesic(pose.rotation, core.target.rotation)
        unit = core.task
        return (metres / unit.step_translation) ** 2 + (radians / unit.step_rotation) ** 2
