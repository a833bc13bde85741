"""The thirteen actions: unit steps along and about the axes of the probe, and idle."""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise, rotate
from racines_envs.task.sensing import all_hold

_AXES = ("x", "y", "z", "rx", "ry", "rz")
ACTIONS = (*(f"{sign}{axis}" for axis in _AXES for sign in "+-"), "idle")
"""Names in index order: +x, -x, +y, … +rz, -rz, idle."""
IDLE = len(ACTIONS) - 1


class ActionTable(NamedTuple):
    """What each action does, in the probe frame."""

    translation: Tensor
    """(13, 3) m."""
    rotation: Tensor
    """(13, 3, 3)."""

    @classmethod
    def make(cls, step_translation: float, step_rotation: float, device: torch.device | str):
        """Tabulate the actions for unit steps in m and rad."""
        signs = torch.tensor([1.0, -1.0])
        units = (torch.eye(6).unsqueeze(1) * signs.view(1, 2, 1)).reshape(12, 6)
        units = torch.cat([units, torch.zeros(1, 6)])
        turns = axis_angle_to_matrix(units[:, 3:] * step_rotation)
        return cls((units[:, :3] * step_translation).to(device), turns.to(device))

    def move(self, pose: Pose, action: Tensor) -> Pose:
        """Return the poses after (N,) actions, whatever the limits; idle leaves a pose as it is."""
        position = pose.position + rotate(pose.rotation, self.translation[action])
        turned = orthonormalise(matmul3(pose.rotation, self.rotation[action]))
        turns = (action >= 6) & (action < IDLE)
        return Pose(position, torch.where(turns[:, None, None], turned, pose.rotation))


def check_actions(action: Tensor, count: int) -> Tensor:
    """Return (count,) int64 actions, if they are integers in 0-12.

    On an accelerator the range is asserted on the device, without waiting for it.
    """
    if action.shape != (count,):
        raise RacinesError(f"actions have shape {tuple(action.shape)}: give ({count},)")
    if action.is_floating_point() or action.is_complex() or action.dtype == torch.bool:
        raise RacinesError(f"actions are {action.dtype}: give integers 0-{IDLE}")
    inside = (action >= 0) & (action <= IDLE)
    if not all_hold(inside):
        bad = int(action[~inside][0])
        raise RacinesError(f"action {bad} is out of range: give integers 0-{IDLE}")
    return action.to(torch.int64)
