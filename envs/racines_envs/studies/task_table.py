"""The tasks as tables for people: `python -m racines_envs.studies.task_table`."""

import math
from typing import Any

import torch

from racines_data.geometry import Pose, matrix_to_euler
from racines_data.phantom.model import Phantom
from racines_data.tables import code, markdown_table
from racines_data.views import VIEW_TITLES, organs
from racines_envs.task.actions import ACTIONS
from racines_envs.task.tasks import TASKS, Task

_ENDS = {
    "first_hit": "at the first hit",
    "k_hits": "after {hits} hits in a row",
    "timeout": "never before the last step",
}


def task_table(task: Task, phantom: Phantom) -> str:
    """Return the Markdown table of a task on a phantom: lengths in mm, angles in rad."""
    space = phantom.workspace
    low, high = (_list(1e3 * edge, 0) for edge in (space.position_min, space.position_max))
    title = phantom.titles.get(task.view) or VIEW_TITLES.get(task.view, "")
    rows = [
        ("target", f"{task.view}, {title} (label {task.target})"),
        ("nominal pose", _pose(phantom.target(task.view))),
        ("start, along the block's top", f"{_range(task.start_distance, 1e3)} mm from there"),
        ("start, height", f"{_range(task.start_height, 1e3)} mm above it"),
        ("start, rotation", f"{_range(task.start_angle)} rad from it, about any axis"),
        ("start, view", "any but the target's"),
        ("actions", f"{len(ACTIONS)}: ± along and about the probe's x, y, z; idle"),
        ("unit steps", f"{1e3 * task.step_translation:g} mm, {task.step_rotation:g} rad"),
        ("workspace", f"from ({low}) to ({high}) mm"),
        ("lean and turn", f"at most {space.tilt_max:g} and {space.yaw_max:g} rad"),
        ("normal force", f"at most {task.force_limit:g} N"),
        ("terminated", _ENDS[task.termination].format(hits=task.hits)),
        ("truncated", f"after {task.max_steps} steps"),
    ]
    return markdown_table((code(task.id), ""), rows)


def task_tables(anatomy: str, phantom: Phantom) -> str:
    """Return the tables of all tasks of an anatomy."""
    tasks = (task for task in TASKS.values() if task.anatomy == anatomy)
    return "\n\n".join(task_table(task, phantom) for task in tasks)


def _pose(pose: Pose) -> str:
    angles = matrix_to_euler(pose.rotation)[0]
    angles = _list(torch.where(angles < -3.1415, angles + 2.0 * math.pi, angles), 3)
    return f"({_list(1e3 * pose.position[0], 1)}) mm, ({angles}) rad, extrinsic xyz"


def _list(values: Any, digits: int) -> str:
    # Plus zero: a minus before nothing but zeros is rounding, and differs between processors.
    return ", ".join(f"{round(value, digits) + 0.0:.{digits}f}" for value in values.tolist())


def _range(limits: tuple[float, float], scale: float = 1.0) -> str:
    return f"{scale * limits[0]:g} to {scale * limits[1]:g}"


def main() -> None:
    """Print the tables of all organs."""
    from racines_data.phantom import PhantomConfig, shared_phantom
    from racines_data.terminal import say_page

    for anatomy in organs():
        say_page(task_tables(anatomy, shared_phantom(PhantomConfig(anatomy=anatomy))) + "\n")


if __name__ == "__main__":
    main()
