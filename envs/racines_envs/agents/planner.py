"""The informed upper bound: it knows the nominal pose, and goes there greedily."""

from typing import ClassVar

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic
from racines_envs.agents.protocol import Untrained
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.names import TIERS
from racines_envs.task.rewards import is_hit
from racines_envs.task.sensing import KnowsWays
from racines_envs.task.tasks import Task


def cost_to_go(pose: Pose, goal: Pose, task: Task) -> Tensor:
    """Return |Δp|²/u² + θ²/w² of (M,) poses to their goals, with a task's unit steps u and w.

    The squares let the axis with most unit steps left go first.
    """
    metres = (pose.position - goal.position).norm(dim=-1)
    radians = geodesic(pose.rotation, goal.rotation)
    return (metres / task.step_translation) ** 2 + (radians / task.step_rotation) ** 2


class PlannerAgent(Untrained):
    """Takes the step that most reduces the cost to go to the nominal pose; idles on a hit.

    Steps that the limits would refuse are left out. In recordings alone it goes the shortest way
    along recorded poses to one that hits.
    """

    name: ClassVar[str] = "planner"
    sees: ClassVar[str] = "truth"
    tiers: ClassVar[tuple[str, ...]] = TIERS

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
        moved, allowed = core.options()
        world: object = core.phantom
        knows = isinstance(world, KnowsWays)
        target = world.waypoint(core.state.pose) if knows else core.target
        # One goal for all rows, or one for each of them.
        rows = torch.arange(count, device=core.device).repeat_interleave(options)
        goal = Pose(*(x.expand(count, *x.shape[1:])[rows] for x in target))
        cost = cost_to_go(moved, goal, core.task).view(count, options)
        best = torch.where(allowed, cost, torch.inf).argmin(1)
        arrived = is_hit(core.score, core.rewards) & is_hit(core.scored_by("oracle"), core.rewards)
        return torch.where(arrived, IDLE, best)
