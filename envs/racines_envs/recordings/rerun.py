"""Run a recorded episode again, and check that the same actions lead to the same poses."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig
from racines_envs.recordings.episode_writer import CONTACT, SCHEMA
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import RewardConfig, get_reward
from racines_envs.task.tasks import Task
from racines_envs.worlds.making import make_core

TOLERANCE = 1e-5
"""Largest difference of a repeated pose, m and rad: rounding on another processor stays below."""


@dataclass(frozen=True)
class RecordedEpisode:
    """A JSONL file as it was read."""

    header: dict[str, Any]
    steps: list[dict[str, Any]]
    """Entry 0 is the start."""


@dataclass(frozen=True)
class Rerun:
    """How an episode that was run again compares with its recording."""

    steps: int
    position_error: float
    """Largest, m."""
    rotation_error: float
    """Largest, rad."""
    reward_error: float | None
    """Largest; None where the reward needs images (`paper`), which are not drawn again."""


def read_recording(path: Path) -> RecordedEpisode:
    """Read the JSONL file of an episode; it is refused where it is damaged or of another schema."""
    path = Path(path)
    if not path.is_file():
        raise RacinesError(f"{path}: no such recording")
    lines = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError as error:
            where = f"{path}, line {number}"
            raise RacinesError(f"{where}: no JSON ({error}): record it anew") from error
    if not lines or lines[0].get("schema") != SCHEMA:
        raise RacinesError(f"{path}: line 1 names no schema {SCHEMA!r}: not a recorded episode")
    if len(lines) < 2:
        raise RacinesError(f"{path}: it ends before the start pose: record it anew")
    for number, line in enumerate(lines[2:], 3):
        if line.get("action") not in ACTIONS:
            raise RacinesError(f"{path}, line {number}: unknown action {line.get('action')!r}")
    return RecordedEpisode(lines[0], lines[1:])


@torch.no_grad()
def rerun(path: Path, core: ScanCore | None = None) -> Rerun:
    """Take the recorded actions from the recorded start, and compare every pose.

    The core has one row; one of the recorded task, phantom and reward by default.

    Raises:
        RacinesError: an unreadable file, another phantom, or poses that differ by more than
            1e-5 m or rad, or the rewards where they can be compared.
    """
    recording = read_recording(path)
    own = core is None
    core = core or _core(recording, path)
    core.reset(0, pose=_pose(recording.steps[0]))
    compared = own and not get_reward(recording.header["reward"]).needs_judge
    metres = radians = rewards = 0.0
    for line in recording.steps[1:]:
        reward = core.step(torch.tensor([ACTIONS.index(line["action"])])).reward
        position, rotation = _pose(line)
        metres = max(metres, float((core.state.position.cpu() - position).norm()))
        radians = max(radians, float(geodesic(core.state.rotation.cpu(), rotation)))
        rewards = max(rewards, abs(float(reward) - line["reward"])) if compared else 0.0
        if max(metres, radians) > TOLERANCE or rewards > 1e-2:
            raise RacinesError(
                f"{path}: step {line['step']} does not repeat: the pose is off by {metres:.2e} m "
                f"and {radians:.2e} rad, the reward by {rewards:.2e}"
            )
    return Rerun(len(recording.steps) - 1, metres, radians, rewards if compared else None)


replay = rerun  # its name of old


def _pose(line: dict[str, Any]) -> Pose:
    return Pose(torch.tensor([line["position"]]), torch.tensor(line["rotation"]).view(1, 3, 3))


def _core(recording: RecordedEpisode, path: Path) -> ScanCore:
    """Return a row of the recorded task that looks at no image."""
    header = recording.header
    task, reward = fill(Task, header["task"], f"{path}: task"), header["reward"]
    if get_reward(reward).needs_judge:
        # Without images nobody knows when the grader ended it: go on as long as the recording did.
        task, reward = replace(task, termination="timeout"), "oracle"
    rewards = fill(RewardConfig, header["rewards"], f"{path}: rewards")
    phantom = _phantom(header, path)
    return make_core(task, observation="params", reward=reward, rewards=rewards, phantom=phantom)


def _phantom(header: dict[str, Any], path: Path) -> Any:
    """Return the configuration of the recorded phantom; its forces decide what was refused."""
    recorded = header["phantom"]
    if header["forces"] != CONTACT:
        raise RacinesError(
            f"{path}: forces of {header['forces']}, which this file does not hold: give core=, one "
            "row with the same"
        )
    if recorded is None:
        raise RacinesError(f"{path}: recorded on a stand-in: give core=, one row of the same")
    if recorded["version"] != PHANTOM_VERSION:
        raise RacinesError(
            f"{path}: recorded on phantom {recorded['version']}, and this is {PHANTOM_VERSION}: "
            "replay it with that version of racines"
        )
    return fill(PhantomConfig, recorded["config"], "phantom.config")
