"""How actions move probes: the thirteen steps, or any twist within the same speeds.

    discrete    (N,) integers 0-12                   one of the unit steps, or idle
    velocity    (N, 6) m/s and rad/s, probe frame    a twist, held for one step of 0.1 s

A unit step is the twist along or about one axis at full speed, so integers are taken for twists
too, and agents that choose among the thirteen act in both. A probe is shifted along the axes that
it has before the step, then turned about the twist's axis: for a twist along or about one axis
alone that is the motion of a rigid body exactly.
"""

from typing import Any, ClassVar, Protocol

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise, rotate
from racines_data.world import STEP_SECONDS
from racines_envs.task.actions import ACTIONS, IDLE, ActionTable, check_actions
from racines_envs.task.sensing import all_hold
from racines_envs.task.tasks import Task

DISCRETE, VELOCITY = "discrete", "velocity"
IDLES_BELOW = 0.05
"""A twist all of whose parts are below this share of their limits is an idle step: hands rest."""
_SLACK = 1e-4
"""By what share a twist may pass its limits: policies squash and unsquash in float32."""


class Motion(Protocol):
    """Moves probes by actions; `name` is what settings call it."""

    name: ClassVar[str]
    table: ActionTable
    """The thirteen steps, which agents that look ahead choose among."""

    def check(self, action: Tensor, count: int) -> Tensor:
        """Return the actions of `count` rows as they are taken.

        Raises:
            RacinesError: a wrong shape, type or value.
        """
        ...

    def move(self, pose: Pose, action: Tensor) -> Pose:
        """Return the poses after (N, …) checked actions, whatever the limits of the task."""
        ...

    def idles(self, action: Tensor) -> Tensor:
        """Return (N,) bool: the checked action leaves the probe where it is."""
        ...

    def tell(self, action: Any) -> Any:
        """Return a row's checked action, a number or list of six, as records write it down."""
        ...

    def read(self, told: Any) -> Any:
        """Return a row's action as `step` takes it, of what `tell` wrote; None: it is none."""
        ...


class Discrete:
    """The thirteen steps."""

    name: ClassVar[str] = DISCRETE

    def __init__(self, task: Task, device: torch.device | str) -> None:
        """Tabulate a task's steps."""
        self.table = ActionTable.make(task.step_translation, task.step_rotation, device)

    def check(self, action: Tensor, count: int) -> Tensor:
        """Return (count,) int64 actions, if they are integers in 0-12."""
        return check_actions(action, count)

    def move(self, pose: Pose, action: Tensor) -> Pose:
        """Return the poses after (N,) actions."""
        return self.table.move(pose, action)

    def idles(self, action: Tensor) -> Tensor:
        """Return (N,) bool: idle."""
        return action == IDLE

    def tell(self, action: Any) -> Any:
        """Return an action's name."""
        return ACTIONS[action]

    def read(self, told: Any) -> Any:
        """Return the number of a name."""
        return ACTIONS.index(told) if told in ACTIONS else None


class Velocity:
    """Twists within limits: the speeds at which a unit step takes one step's time."""

    name: ClassVar[str] = VELOCITY

    def __init__(self, task: Task, device: torch.device | str) -> None:
        """Take a task's steps as the greatest ones."""
        self.table = ActionTable.make(task.step_translation, task.step_rotation, device)
        step = torch.tensor([task.step_translation] * 3 + [task.step_rotation] * 3)
        self._step = step.to(device)
        self.limits = self._step / STEP_SECONDS
        """(6,) m/s and rad/s, float32."""
        units = torch.eye(6).repeat_interleave(2, 0) * torch.tensor([1.0, -1.0] * 6).unsqueeze(1)
        self._units = torch.cat([units, torch.zeros(1, 6)]).to(device) * self.limits

    def check(self, action: Tensor, count: int) -> Tensor:
        """Return (count, 6) float32 twists: those given, or of (count,) integers 0-12."""
        if action.ndim == 1 and not action.is_floating_point():
            return self._units[check_actions(action, count)]
        if action.shape != (count, 6) or not action.is_floating_point():
            raise RacinesError(
                f"actions are {action.dtype} {tuple(action.shape)}: give ({count}, 6) floats, a "
                "twist in the probe's frame in m/s and rad/s, or integers 0-12"
            )
        twist = action.to(self.limits)
        inside = (twist.abs() <= self.limits * (1.0 + _SLACK)).all(1)  # false where it is NaN
        if not all_hold(inside):
            bad = [round(value, 4) for value in twist[~inside][0].tolist()]
            metres, radians = self.limits[0].item(), self.limits[3].item()
            raise RacinesError(
                f"action {bad}: a twist has to be finite, at most {metres:g} m/s along and "
                f"{radians:g} rad/s about each axis of the probe"
            )
        return twist.clamp(-self.limits, self.limits)

    def move(self, pose: Pose, action: Tensor) -> Pose:
        """Return the poses after (N, 6) twists were held for one step."""
        shift = action / self.limits * self._step  # exactly a unit step at full speed
        idle, turns = self.idles(action), (action[:, 3:] != 0).any(1)
        turned = orthonormalise(matmul3(pose.rotation, axis_angle_to_matrix(shift[:, 3:])))
        moved = pose.position + rotate(pose.rotation, shift[:, :3])
        keep = idle | ~turns
        return Pose(
            torch.where(idle[:, None], pose.position, moved),
            torch.where(keep[:, None, None], pose.rotation, turned),
        )

    def idles(self, action: Tensor) -> Tensor:
        """Return (N,) bool: every part lies below a twentieth of its limit."""
        return (action.abs() < IDLES_BELOW * self.limits).all(1)

    def tell(self, action: Any) -> Any:
        """Return the six numbers."""
        return action

    def read(self, told: Any) -> Any:
        """Return six numbers as they are."""
        fits = isinstance(told, list) and len(told) == 6
        return told if fits and all(isinstance(each, (int, float)) for each in told) else None


_MOTIONS: dict[str, type[Discrete] | type[Velocity]] = {DISCRETE: Discrete, VELOCITY: Velocity}


def make_motion(name: str, task: Task, device: torch.device | str) -> Discrete | Velocity:
    """Return how actions of a name move the probes of a task.

    Raises:
        RacinesError: an unknown name.
    """
    if name not in _MOTIONS:
        raise RacinesError(f"unknown action {name!r}: choose one of {', '.join(_MOTIONS)}")
    return _MOTIONS[name](task, device)
