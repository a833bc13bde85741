"""What is told of an environment's rows beside what their agents see: `info`, for reports."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from torch import Tensor

from racines_envs.task import sensing
from racines_envs.task.names import HEART_TIER
from racines_envs.task.tiers import STEP_SECONDS

if TYPE_CHECKING:
    from racines_envs.task.core import ScanCore


def told_of(core: "ScanCore", sensed: Mapping[str, Tensor], view_error: bool) -> dict[str, Tensor]:
    """Return what the agent is not told, N rows each.

    `view` and `grade` are the oracle's; `success` is the true view being the target's,
    `success_graded` also a true grade of at least 5; on patients both are `succeeds`, and there
    are `reached` (hits enough in a row on the way), `declared`, `goal`, and `seconds` that the
    steps took. `probability` and `score` are p and g by the reward's own source. Forces in N,
    errors in m and rad: to the nominal pose, and those of the view (left out without
    `view_error`: they cost as much as some steps) to the nearest pose that truly shows it.
    `out_of_support` is there if the source of images tells it, and `arm_hits`, steps that the arm
    could not follow, if one carries the probe; recordings that stand alone tell the `frame` shown,
    its row in the store, and its `frame_distance`.

    Args:
        core: whose rows.
        sensed: what it sensed of them last: `view` and `grade` by the oracle.
        view_error: whether the errors of the view are wanted.
    """
    state, success = core.state, core.succeeds()
    metres, radians = core.pose_error()
    further: dict[str, Tensor] = {}
    if view_error:
        names = ("view_position_error", "view_rotation_error")
        further |= dict(zip(names, core.view_error(), strict=True))
    if isinstance(core.images, sensing.KnowsSupport):
        further["out_of_support"] = core.images.out_of_support(core.parameters)
    if core.task.tier != HEART_TIER:
        further |= _of_patients(core)
    if isinstance(scene := core.scene(), sensing.TellsFrames):
        further |= scene.told(state.pose)
    if core.robot.joints:
        further["arm_hits"] = state.arm_hits
    return further | {
        "view": sensed["view"],
        "grade": sensed["grade"],
        "success": success,
        "success_graded": success & (sensed["grade"] >= core.rewards.grade),
        "probability": core.score.probability,
        "score": core.score.grade,
        "steps": state.steps,
        "return": state.total,
        "force": state.force,
        "peak_force": state.peak_force,
        "mean_force": state.force_sum / state.steps.clamp_min(1),
        "workspace_hits": state.workspace_hits,
        "force_hits": state.force_hits,
        "position_error": metres,
        "rotation_error": radians,
    }


def _of_patients(core: "ScanCore") -> dict[str, Tensor]:
    state = core.state
    return {
        "reached": state.reached,
        "declared": state.idle >= core.task.idles,
        "goal": state.goal,
        "seconds": STEP_SECONDS * state.steps,
    }
