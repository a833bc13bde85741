"""What a dataset's trajectories teach: for each frame, the step towards a goal known by hindsight.

frame i ──── unit step? ────> goal j of the same trajectory, or of the same heart
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose, rotation_6d
from racines_data.store.frames import FrameStore
from racines_envs.agents.planner import cost_to_go
from racines_envs.task.actions import ACTIONS, IDLE, ActionTable
from racines_envs.task.tasks import Task

CHUNK = 8192
"""Poses whose costs are found at once."""


class Demonstrations(NamedTuple):
    """M frames and what to do there."""

    rows: Tensor
    """(M,) int64 rows of the store."""
    trajectory: Tensor
    """(M,) int64, the trajectory of each."""
    cost: Tensor
    """(M, 13) squared distance to the goal after each action, in unit steps."""
    action: Tensor
    """(M,) int64, the action of least cost; idle where the view is well in sight."""

    @property
    def trajectories(self) -> int:
        """How many trajectories they come from."""
        return len(self.trajectory.unique())


def demonstrations(
    store: FrameStore, split: str, task: Task, *, horizon: int = 150, both_ways: bool = True,
    least_grade: float = 5.0, still_grade: float = 6.5,
) -> Demonstrations:  # fmt: skip
    """Label the frames of a split that have a goal.

    The goal is the best-graded frame of the target view, of `least_grade` or more, at most
    `horizon` frames after it on the same trajectory. With `both_ways` it may lie before it as well:
    nothing moves in the block but the probe, so a hand that leaves, played backwards, arrives. With
    a `horizon` of 0 it is the best of the same heart: patient, or all of the split. From a
    `still_grade` of the target view on, the label is to idle.

    Raises:
        RacinesError: the dataset does not know the view, or no frame has a goal.
    """
    if task.view not in store.labels:
        raise RacinesError(f"{store.root}: has no view {task.view}: {', '.join(store.labels)}")
    start, stop = store.bounds(split)
    seen = store.views[start:stop] == store.labels.index(task.view)
    worth = torch.where(seen, store.grades[start:stop], torch.nan)
    worth = torch.where(worth >= least_grade, worth, 0.0)
    pose = parameters_to_pose(store.parameters[start:stop])
    if not bool((worth > 0).any()):
        raise RacinesError(
            f"{store.root}: no frame of split {split!r} shows {task.view} with a grade of "
            f"{least_grade:g} or more: there is nothing to imitate; lower least_grade, or build "
            "more frames"
        )
    trajectory = store.trajectory_index[start:stop]
    if horizon:
        goal = _within(worth, trajectory, horizon, both_ways)
    else:
        goal = _of_heart(worth, hearts(store, trajectory))
    rows = (goal >= 0).nonzero().squeeze(1)
    cost = costs(_rows(pose, rows), _rows(pose, goal[rows]), task)
    still = worth[rows] >= still_grade
    action = torch.where(still, IDLE, cost.argmin(1))
    return Demonstrations(rows + start, trajectory[rows], cost, action)


def costs(pose: Pose, goal: Pose, task: Task) -> Tensor:
    """Return the planner's (M, 13) costs to go to M goals after each action."""
    table = ActionTable.make(task.step_translation, task.step_rotation, pose.position.device)
    count, parts = len(ACTIONS), []
    for rows in torch.arange(len(pose.position)).split(CHUNK):
        each = rows.repeat_interleave(count)
        moved = table.move(_rows(pose, each), torch.arange(count).repeat(len(rows)))
        parts.append(cost_to_go(moved, _rows(goal, each), task).view(-1, count))
    return torch.cat(parts)


def encode_params(parameters: Tensor, workspace: Any) -> Tensor:
    """Return the (M, 9) observation `params` of (M, 12) recorded parameters (see `ScanCore`)."""
    pose = parameters_to_pose(parameters)
    centre = (workspace.position_max + workspace.position_min) / 2
    half = (workspace.position_max - workspace.position_min) / 2
    encoded = torch.cat([(pose.position - centre) / half, rotation_6d(pose.rotation)], -1)
    return encoded.clamp(-1.0, 1.0)


def _within(worth: Tensor, trajectory: Tensor, horizon: int, both_ways: bool) -> Tensor:
    """Return the (n,) best goals in the window of each frame's own trajectory, -1 for none."""
    counts = torch.unique_consecutive(trajectory, return_counts=True)[1].tolist()
    goals, first = [], 0
    for best in worth.split(counts):
        rows = torch.arange(len(best))
        ahead = rows[None] - rows[:, None]
        near = (ahead.abs() if both_ways else ahead) <= horizon
        near &= both_ways | (ahead >= 0)
        value, index = torch.where(near, best[None], 0.0).max(1)
        goals.append(torch.where(value > 0, index + first, -1))
        first += len(best)
    return torch.cat(goals)


def _of_heart(worth: Tensor, heart: Tensor) -> Tensor:
    """Return the (n,) best goals on each frame's own heart, the first of equals, -1 for none."""
    count, rows = int(heart.max()) + 1, torch.arange(len(worth))
    best = worth.new_zeros(count).scatter_reduce(0, heart, worth, "amax")[heart]
    tried = torch.where(worth == best, rows, len(rows))
    first = torch.full((count,), len(rows)).scatter_reduce(0, heart, tried, "amin")
    return torch.where(best > 0, first[heart], -1)


def hearts(store: FrameStore, trajectory: Tensor) -> Tensor:
    """Return the (n,) numbers of the hearts that (n,) trajectories scan."""
    if store.patients is None:
        return torch.zeros_like(trajectory)
    return torch.tensor(store.patients)[trajectory].unique(return_inverse=True)[1]


def _rows(pose: Pose, rows: Tensor) -> Pose:
    return Pose(*(each[rows] for each in pose))
