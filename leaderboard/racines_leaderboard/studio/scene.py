"""What a page shows of one moment of an episode, taken from a core: pictures, forces, judgement."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

ZOOM = 2
"""Of the views of the block: twice a screen's pixels, so that their text stays sharp."""


@dataclass(frozen=True)
class Curve:
    """Whose judgement of the images, step by step from the start on."""

    name: str
    probabilities: Sequence[float]
    """Of the target view."""
    grades: Sequence[float]
    """As the target view, 0-10."""


@dataclass(frozen=True)
class Truth:
    """What the phantom knows and an agent is not told."""

    view: str
    grade: float
    millimetres: float
    """To the nominal pose."""
    degrees: float
    out_of_support: bool


@dataclass(frozen=True)
class Scene:
    """One moment of an episode."""

    task: str
    view: str
    step: int
    most: int
    """Steps after which the episode is over."""
    action: str
    """The last one, or `start`."""
    image: np.ndarray
    """(128, 128) uint8."""
    above: Image.Image
    front: Image.Image
    force: float
    """Normal force, N; with its limit and its peak so far."""
    limit: float
    peak: float
    wrench: tuple[float, ...]
    """Force, N, and torque, N·m, in the probe's axes."""
    refused: tuple[int, int]
    """Steps that were refused at the workspace, and at the force limit."""
    curves: tuple[Curve, ...]
    needed: tuple[float, float]
    """p and grade of a hit."""
    ended: str
    """Why the episode is over; empty while it is not."""
    success: bool
    truth: Truth | None
    """None where it is hidden."""


@dataclass(frozen=True)
class Snapshot:
    """The only row of a core at one moment, to be drawn later."""

    state: Any
    info: dict[str, Any]
    """`ScanCore.info`, as numbers."""
    image: Any
    """(1, 128, 128) uint8 tensor."""


def snapshot(core: Any) -> Snapshot:
    """Return the present moment of a core of one row."""
    info = {name: value[0].item() for name, value in core.info(view_error=False).items()}
    return Snapshot(copy.copy(core.state), info, core.picture())


def take_scene(
    core: Any, moment: Snapshot, steps: Any, curves: Sequence[Curve], truth: bool
) -> Scene:
    """Return what a page shows of a moment of a core; `steps` are those so far."""
    from racines_envs.apis.rendering import block_views
    from racines_envs.task.actions import ACTIONS

    core, info = copy.copy(core), moment.info
    core.state = moment.state
    task, last = core.task, steps.actions[-1]
    above, front = block_views(core, 0, steps, truth, ZOOM)
    return Scene(
        task=task.id,
        view=task.view,
        step=int(info["steps"]),
        most=task.max_steps,
        action="start" if last is None else ACTIONS[last],
        image=moment.image[0].cpu().numpy(),
        above=above,
        front=front,
        force=info["force"],
        limit=task.force_limit,
        peak=info["peak_force"],
        wrench=tuple(core.state.wrench[0].tolist()),
        refused=(int(info["workspace_hits"]), int(info["force_hits"])),
        curves=tuple(curves),
        needed=(core.rewards.probability, core.rewards.grade),
        ended=_why(core, bool(info["success"])),
        success=bool(info["success"]),
        truth=_truth(core, info) if truth else None,
    )


def _why(core: Any, success: bool) -> str:
    if not bool(core.state.done[0]):
        return ""
    task = core.task
    if task.hits_to_end and int(core.state.streak[0]) >= task.hits_to_end:
        return f"{task.view} was held for {task.hits_to_end} steps in a row"
    shown = "the view is in sight" if success else "the view was not found"
    return f"all {task.max_steps} steps are taken, and {shown}"


def _truth(core: Any, info: dict[str, Any]) -> Truth:
    from racines_envs.apis.rendering import view_names

    return Truth(
        view=view_names(core)[int(info["view"])],
        grade=info["grade"],
        millimetres=1e3 * info["position_error"],
        degrees=math.degrees(info["rotation_error"]),
        out_of_support=bool(info.get("out_of_support", False)),
    )
