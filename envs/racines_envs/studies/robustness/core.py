"""The environment under disturbances: between the world and the agent."""

from dataclasses import replace

from torch import Tensor

from racines_data.geometry import Pose
from racines_data.randomness import derive
from racines_data.world import World
from racines_envs.studies.robustness.disturbances import Applied
from racines_envs.task.core import ScanCore
from racines_envs.task.state import State

STREAM = 449
"""Random stream of what a disturbance does at a step."""


class DisturbedCore(ScanCore):
    """An environment in which pictures, reports of the arm and steps are disturbed.

    The truth is that of the pose where the probe is. What an agent under `applied` is not shown or
    asked for stays as it is.
    """

    def __init__(self, core: ScanCore, applied: Applied) -> None:
        """Take an environment's parts, and what disturbs it."""
        super().__init__(
            core.task, core.phantom, core.images, core.grader, core.observation, core.reward,
            core.rewards, core.num_envs, core.device, core.encoder, core.forces,
        )  # fmt: skip
        self.applied = applied

    def told_pose(self) -> Pose:
        """Return the poses that the arm reports."""
        pose = super().told_pose()
        for each, amount in self.applied.items():
            pose = pose if each.told is None else each.told(pose, self.state.seed, amount)
        return pose

    def _move(self, state: State, action: Tensor, live: Tensor) -> State:
        seeds = derive(state.seed, state.steps, STREAM)
        asked = action
        for each, amount in self.applied.items():
            if each.slip is not None:
                slid = each.slip(state.pose, asked, seeds, amount)
                free = self.phantom.workspace.contains(slid) & live
                position = slid.position.where(free.unsqueeze(1), state.position)
                state = replace(state, position=position)
            action = action if each.action is None else each.action(action, seeds, amount)
        return super()._move(state, action, live)

    def _draw(self, parameters: Tensor, seeds: Tensor, scene: World) -> Tensor:
        images = super()._draw(parameters, seeds, scene)
        episodes = self._looked_at if len(self._looked_at) == len(images) else self.state.seed
        for each, amount in self.applied.items():
            images = images if each.image is None else each.image(images, episodes, amount)
        return images

    def _sense(self, rows: Tensor | None = None) -> None:
        self._looked_at = self.state.taken(rows).seed
        super()._sense(rows)
