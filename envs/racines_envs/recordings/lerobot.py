"""A dataset in the LeRobot format whose states and actions are those of the tasks.

What `racines_data.export.lerobot` writes as recorded stands here as an agent meets it in a task:
`observation.state` are the nine numbers of the pose that the environments show (`params`), and
`action` is the commanded velocity as a twist in the probe's frame, m/s and rad/s, cut at the task's
limits. Hence a policy that was trained on it acts in the tasks, and as an ONNX file on the board.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.export.lerobot.writer import ACTION, STATE, Shown
from racines_data.export.lerobot.writer import export as export_recorded
from racines_data.geometry import parameters_to_pose
from racines_data.manifest import read_manifest
from racines_data.phantom.config import phantom_settings, recorded_phantom
from racines_data.phantom.model import workspace_of
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.store.sweeps import Sweep
from racines_data.world import STEP_SECONDS
from racines_envs.apis.lerobot.formats import POSE, RECORDED, TASK, TWIST, twist_of
from racines_envs.task.motion import Velocity
from racines_envs.task.sensing import box_of, encode_pose
from racines_envs.task.tasks import get_task

_TOLD = (
    "`observation.state` is the pose in the workspace's box and its continuous rotation, as the "
    "tasks show it; `action` the commanded twist in the probe's frame, m/s and rad/s, cut at the "
    "tasks' limits."
)


@dataclass
class _Reading:
    """Turns sweeps into what a task's agent sees and does, and counts what was cut."""

    box: tuple[Tensor, Tensor]
    limits: Tensor
    frames: int = 0
    cut: int = field(default=0)

    def __call__(self, sweep: Sweep) -> dict[str, np.ndarray]:
        pose = parameters_to_pose(torch.from_numpy(float_columns(sweep.table, PARAMETERS)))
        velocity = torch.from_numpy(float_columns(sweep.table, CONTROLS))
        twist = twist_of(velocity, pose.rotation)
        held = twist.clamp(-self.limits, self.limits)
        self.frames += len(held)
        self.cut += int(((held != twist) & ~twist.isnan()).any(1).sum())
        return {STATE: encode_pose(pose, *self.box).numpy(), ACTION: held.numpy()}


def export(
    root: Path,
    out: Path,
    split: str | None = None,
    limit: int | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Write a dataset of the simulated heart; images have three equal channels.

    Arguments, errors and result as of `racines_data.export.lerobot.export`, and an error where the
    data are of no phantom: then there is no task whose workspace would be known.
    """
    manifest = read_manifest(root)
    if phantom_settings(manifest, "frames") is None:
        raise RacinesError(
            f"{root}: {manifest['source']} data have no phantom, hence no task's workspace: "
            f"use --format {RECORDED}"
        )
    phantom = recorded_phantom(manifest)
    space = workspace_of(phantom.workspace, phantom.block, torch.device("cpu"))
    reading = _Reading(box_of(space), Velocity(get_task("SC"), "cpu").limits)
    shown = Shown(TASK, reading, POSE, TWIST, _TOLD)
    made = export_recorded(root, out, split, limit, progress, channels=3, shown=shown)
    return made | {"notes": [*made["notes"], *_notes(reading, made["fps"])]}


def _notes(reading: _Reading, fps: float) -> Sequence[str]:
    steps = 1.0 / STEP_SECONDS
    notes = []
    if reading.cut:
        notes.append(
            f"{reading.cut} of {reading.frames} twists were cut at the task's limits: hands are "
            "faster than probes in tasks; longer sweeps are slower"
        )
    if abs(fps - steps) > 1e-6:
        notes.append(f"frames are 1/{fps:g} s apart, steps of the tasks {STEP_SECONDS:g} s")
    return notes
