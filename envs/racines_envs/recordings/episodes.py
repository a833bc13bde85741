"""Episodes on disk: one JSONL file each, and a picture of it in motion; run again, and checked.

    episode_0000.jsonl    line 1: task, settings, seeds, phantom, versions
                          line 2: step 0, the start; then one line a step, in order
    episode_0000.gif      the frames of `racines_envs.apis.rendering.compose`

Files are written when an episode ends, whole; running again writes the same names again.
"""

import io
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import torch
from gymnasium.utils import RecordConstructorArgs
from PIL import Image
from torch import Tensor

from racines_data.config import fill
from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.geometry import Pose, geodesic
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig
from racines_envs.agents.protocol import Agent
from racines_envs.apis.reading import read_actions
from racines_envs.apis.rendering import History, compose
from racines_envs.robots.arm import FREE
from racines_envs.task.core import ScanCore
from racines_envs.task.motion import DISCRETE, make_motion
from racines_envs.task.rewards import RewardConfig, get_reward
from racines_envs.task.state import Transition
from racines_envs.task.tasks import Task
from racines_envs.worlds.making import make_core
from racines_models.provenance import code_version

SCHEMA = "racines.episode/1"
CONTACT = "contact"
"""Forces of the phantom's contact model, in the header; else the class that tells them."""
FRAME_MS = 100
_COLOURS = 128
TOLERANCE = 1e-5
"""Largest difference of a repeated pose, m and rad: rounding on another processor stays below."""


class CoreRecorder:
    """Records the first episodes of the first rows of a core, one episode a row at a time."""

    def __init__(
        self, core: ScanCore, folder: Path, maximum: int = 10, video: bool = True, agent: str = ""
    ) -> None:
        """Record into a folder.

        The folder is made when the first episode is written; numbers go on after those that lie
        there. After `maximum` episodes nothing is recorded. `video`: a GIF goes with each; `agent`:
        who acts, for the header.
        """
        self.core, self.folder, self.video = core, Path(folder), video
        self.written: list[Path] = []
        """The JSONL files so far."""
        self._common = _header(core) | ({"agent": agent} if agent else {})
        self._history = History(core.num_envs)
        self._open: dict[int, tuple[Path, list[dict[str, Any]], list[Image.Image]]] = {}
        numbers = [path.stem.removeprefix("episode_") for path in self.folder.glob("episode_*.*")]
        self._next = max((int(n) + 1 for n in numbers if n.isdecimal()), default=0)
        self._left = maximum

    def start(self, seeds: list[int | None] | None = None) -> None:
        """Begin an episode in every row that has just been reset; what was unfinished is written.

        `seeds` are those that the rows were reset with, where somebody gave any.
        """
        self.finish()
        self._history.note(self.core)
        info = self.core.info()
        for row in range(min(self.core.num_envs, self._left)):
            given = {} if seeds is None or seeds[row] is None else {"reset_seed": seeds[row]}
            head = self._common | {"seed": int(self.core.state.seed[row])} | given
            path = self.folder / f"episode_{self._next + row:04d}.jsonl"
            self._open[row] = path, [head], []
            self._add(row, info, None, 0.0, False, False)
        self._next += len(self._open)
        self._left -= len(self._open)

    def step(self, actions: Tensor, transition: Transition) -> None:
        """Add a step of all rows, and write the episodes that it ended."""
        if not self._open:
            return
        self._history.note(self.core, actions)
        info, taken = self.core.info(), self.core.motion.check(actions, self.core.num_envs)
        columns = (taken, transition.reward, transition.terminated, transition.truncated)
        for row, values in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            if row not in self._open:
                continue
            self._add(row, info, *values)
            if values[2] or values[3]:
                self._write(row)

    def finish(self) -> None:
        """Write the episodes that have not ended, as they stand."""
        for row in list(self._open):
            self._write(row)

    def _add(
        self, row: int, info: dict[str, Tensor], action: Any, reward: float, ended: bool,
        cut: bool,
    ) -> None:  # fmt: skip
        state, (_, lines, frames) = self.core.state, self._open[row]
        line = {
            "step": int(state.steps[row]),
            "action": None if action is None else self.core.motion.tell(action),
            "position": state.position[row].tolist(),
            "rotation": state.rotation[row].flatten().tolist(),
            "wrench": state.wrench[row].tolist(),
            **({"joints": state.joints[row].tolist()} if self.core.robot.joints else {}),
            "reward": reward,
            "terminated": ended,
            "truncated": cut,
            "info": {name: value[row].item() for name, value in info.items()},
        }
        lines.append(line)
        if self.video:
            frame = Image.fromarray(compose(self.core, row, self._history))
            few = frame.quantize(_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
            frames.append(few)

    def _write(self, row: int) -> None:
        """Write one episode; the record goes last, so that where it is the video is too."""
        path, lines, frames = self._open.pop(row)
        if frames:
            buffer, rest = io.BytesIO(), frames[1:]
            frames[0].save(
                buffer, "GIF", save_all=True, append_images=rest, duration=FRAME_MS, loop=0
            )
            write_atomic(path.with_suffix(".gif"), buffer.getvalue())
        write_atomic(path, "".join(json.dumps(line) + "\n" for line in lines))
        self.written.append(path)


def _header(core: ScanCore) -> dict[str, Any]:
    """Return what a replay has to know, and where the numbers come from."""
    phantom: dict[str, Any] | None = None
    if core.phantom.config is not None:
        phantom = {"version": PHANTOM_VERSION, "config": asdict(core.phantom.config)}
        phantom["recipe_digest"] = recipe_digest(phantom)
    own = core.motion.name
    return {
        "schema": SCHEMA,
        "task": core.task.definition,
        **({} if own == DISCRETE else {"action": own}),
        **({"robot": core.robot.name} if core.robot.joints else {}),
        "observation": core.observation,
        "reward": core.reward.name,
        "rewards": asdict(core.rewards),
        "images": type(core.images).__name__,
        "forces": CONTACT if core.forces is core.phantom else type(core.forces).__name__,
        "phantom": phantom,
        "code": code_version(),
    }


class EpisodeRecorder(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Records the episodes of one Gymnasium environment of ours.

        env = EpisodeRecorder(gymnasium.make("racines_envs:racines/SC-v0"), "recordings")

    An episode that was left by a reset or by `close` is written as far as it came.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], folder: Path | str, maximum: int = 10,
        video: bool = True,
    ) -> None:  # fmt: skip
        """Wrap an environment, which has to be one of ours; see `CoreRecorder` for the rest."""
        RecordConstructorArgs.__init__(self, folder=str(folder), maximum=maximum, video=video)
        gymnasium.Wrapper.__init__(self, env)
        core = getattr(env.unwrapped, "core", None)
        if not isinstance(core, ScanCore):
            raise RacinesError(
                f"{env.unwrapped} cannot be recorded: give racines_envs:racines/<VIEW>-v0"
            )
        self._recorder = CoreRecorder(core, Path(folder), maximum, video)
        self.written = self._recorder.written
        """The JSONL files so far."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset, and begin a record."""
        result = self.env.reset(seed=seed, options=options)
        self._recorder.start([seed])
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and add it to the record."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        flags = (torch.tensor([reward]), torch.tensor([terminated]), torch.tensor([truncated]))
        taken = read_actions(action, self._recorder.core)
        self._recorder.step(taken, Transition({}, *flags))
        return seen, reward, terminated, truncated, info

    def close(self) -> None:
        """Write what is left, and close."""
        self._recorder.finish()
        super().close()


@torch.no_grad()
def record_rollout(
    core: ScanCore, agent: Agent, seeds: Tensor, folder: Path, maximum: int = 4, video: bool = True
) -> list[Path]:
    """Let an agent act from (n,) seeds until the first rows, which are recorded, have ended.

    Returns their JSONL files; n is the core's number of rows, and best no more than are recorded.
    """
    agent.attach(core)
    observation = core.reset(seeds)
    recorder = CoreRecorder(core, folder, maximum, video, getattr(agent, "name", ""))
    recorder.start([int(seed) for seed in seeds])
    count = min(maximum, core.num_envs)
    while not bool(core.state.done[:count].all()):
        action = agent.act(observation, core.decision_seeds())
        transition = core.step(action)
        observation = transition.observation
        recorder.step(action, transition)
    return sorted(recorder.written)


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
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError as error:
            where = f"{path}, line {number}"
            raise RacinesError(f"{where}: no JSON ({error}): record it anew") from error
    if not lines or lines[0].get("schema") != SCHEMA:
        raise RacinesError(f"{path}: line 1 names no schema {SCHEMA!r}: not a recorded episode")
    if len(lines) < 2:
        raise RacinesError(f"{path}: it ends before the start pose: record it anew")
    motion = make_motion(lines[0].get("action", DISCRETE), Task("SC"), "cpu")
    for number, line in enumerate(lines[2:], 3):
        if motion.read(line.get("action")) is None:
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
        action = core.motion.read(line["action"])
        reward = core.step(torch.tensor([action], device=core.device)).reward
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
    return make_core(
        task, observation="params", reward=reward, rewards=rewards, phantom=phantom,
        action=header.get("action", DISCRETE), robot=header.get("robot", FREE),
    )  # fmt: skip


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
