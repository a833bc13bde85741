"""Going to a pose by the thirteen actions, from what every agent may know.

That is the probe's pose, which `params` shows, the workspace, the unit steps, and when an episode
begins. A probe that slips, and an arm that misreads where it is, begin none. A step that changed
nothing was refused (too deep, or out of the workspace) and is not tried again from there.
"""

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, matrix_from_6d
from racines_envs.agents.planner import cost_to_go
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.sensing import box_of

STILL = 1e-5
"""Metres and radians within which a pose is the one before."""


class Steering:
    """Steers the N rows of one environment."""

    def __init__(self, core: ScanCore) -> None:
        """Take workspace, unit steps and the count of steps from an environment, nothing else."""
        self._centre, self._half = (x.to(core.device) for x in box_of(core.phantom.workspace))
        self._table, self._task, self._core = core.table, core.task, core
        self._last: tuple[Pose, Tensor] | None = None
        self._refused: Tensor | None = None

    def pose(self, observation: dict[str, Tensor]) -> Pose:
        """Return the (N,) poses that `params` shows."""
        if "params" not in observation:
            raise RacinesError("steering needs the pose: observe params or multimodal")
        params = observation["params"]
        return Pose(params[:, :3] * self._half + self._centre, matrix_from_6d(params[:, 3:]))

    def goes_on(self) -> Tensor:
        """Return (N,) bool: the episode has begun before, and this agent has acted in it."""
        steps = self._core.state.steps
        return steps > 0 if self._last is not None else torch.zeros_like(steps, dtype=torch.bool)

    def towards(self, pose: Pose, goal: Pose, slack: float = 0.0) -> Tensor:
        """Return the (N,) actions that leave least to do to (N,) goals; idle where none helps.

        Who idled stays where a step saves less than `slack`, in squared unit steps: a goal that
        trembles does not keep an agent from coming to rest.
        """
        action = self._best(pose, goal, self._note(pose), slack)
        self._last = pose, action
        return action

    def by_way_of(
        self, pose: Pose, goal: Pose, then: Pose, slack: float | Tensor = 0.0
    ) -> tuple[Tensor, Tensor]:
        """Return the (N,) actions to goals, or on to the next where these are reached; and where.

        Args:
            pose: (N,) poses.
            goal: (N,) poses to go to first.
            then: (N,) poses to go to from there.
            slack: as of `towards`, or (N,) of each row.
        """
        refused = self._note(pose)
        action = self._best(pose, goal, refused, slack)
        reached = action == IDLE
        action = torch.where(reached, self._best(pose, then, refused, slack), action)
        self._last = pose, action
        return action, reached

    def _best(self, pose: Pose, goal: Pose, refused: Tensor, slack: float | Tensor) -> Tensor:
        """Return the (N,) actions that leave least to do, of those that were not refused."""
        count, options = len(pose.position), len(ACTIONS)
        each = Pose(*(x.repeat_interleave(options, 0) for x in pose))
        moved = self._table.move(
            each, torch.arange(options, device=each.position.device).repeat(count)
        )
        ends = Pose(*(x.repeat_interleave(options, 0) for x in goal))
        cost = cost_to_go(moved, ends, self._task).view(count, options)
        if self._last is not None:
            rested = (self._last[1] == IDLE) & self.goes_on()
            cost[:, IDLE] -= slack * rested
        return torch.where(refused, torch.inf, cost).argmin(1)

    def take(self, action: Tensor) -> Tensor:
        """Return the (N,) actions, which are taken in place of those towards the goals."""
        if self._last is not None:
            self._last = self._last[0], action
        return action

    def _note(self, pose: Pose) -> Tensor:
        """Return (N, 13) bool, the steps that changed nothing, and remember them until one does."""
        refused = torch.zeros(
            (len(pose.position), len(ACTIONS)), dtype=torch.bool, device=pose.position.device
        )
        if self._last is not None and self._refused is not None:
            before, action = self._last
            still = _same(pose, before)
            refused = self._refused & still[:, None]
            vain = still & (action != IDLE)
            refused = refused | (torch.nn.functional.one_hot(action, 13).bool() & vain[:, None])
        self._refused = refused
        return refused


def _same(pose: Pose, other: Pose) -> Tensor:
    shift = (pose.position - other.position).norm(dim=-1)
    return (shift < STILL) & (geodesic(pose.rotation, other.rotation) < 100.0 * STILL)
