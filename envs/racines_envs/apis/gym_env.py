"""The tasks in Gymnasium: one environment, and N rows that take one step for all."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, euler_to_matrix
from racines_data.imaging import IMAGE_SIZE
from racines_envs.apis.rendering import History, compose
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE, ScanCore
from racines_envs.task.motion import Velocity
from racines_envs.task.state import Transition
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import Ward

OPTIONS = ("pose", "patient")
"""What a reset may be told."""


def action_space(core: ScanCore) -> spaces.Space[Any]:
    """Return the space of one row's action: 13 steps, or a twist in m/s and rad/s."""
    if isinstance(core.motion, Velocity):
        limits = core.motion.limits.cpu().numpy()
        return spaces.Box(-limits, limits, dtype=np.float32)
    return spaces.Discrete(len(ACTIONS))


def read_actions(actions: Any, core: ScanCore) -> torch.Tensor:
    """Turn the actions of all rows, in any kind of sequence, into a tensor of (N,) or (N, 6)."""
    twists = isinstance(core.motion, Velocity)
    wanted = "twists of six numbers, m/s and rad/s" if twists else "integers 0-12"
    try:
        array = np.asarray(actions)
    except ValueError as error:
        raise RacinesError(f"actions {actions!r} are ragged: give {wanted}") from error
    if twists and array.dtype.kind == "f":
        alone = array.shape == (6,) and core.num_envs == 1
        return torch.as_tensor(array.astype(np.float32)[None] if alone else array)
    if array.dtype.kind not in "iu":
        kind = "of the wrong kind" if twists else "no integer"
        raise RacinesError(f"action {actions!r} is {kind}: give {wanted}")
    return torch.as_tensor(np.atleast_1d(array).astype(np.int64))


def read_pose(options: dict[str, Any] | None, count: int) -> Pose | None:
    """Read `options["pose"]`: (6,) or (count, 6) m and extrinsic xyz angles rad."""
    options = options or {}
    unknown = set(options) - set(OPTIONS)
    if unknown:
        known = " and ".join(map(repr, OPTIONS))
        raise RacinesError(f"unknown reset option {sorted(unknown)[0]!r}: known are {known}")
    if "pose" not in options:
        return None
    try:
        values = torch.as_tensor(np.asarray(options["pose"], dtype=np.float32))
    except (TypeError, ValueError) as error:
        raise RacinesError(
            f"options['pose'] is no numbers ({options['pose']!r}): give position in m and angles "
            "in rad"
        ) from error
    if values.shape not in ((6,), (count, 6)):
        raise RacinesError(
            f"options['pose'] has shape {tuple(values.shape)}: give (6,) or ({count}, 6), position "
            "in m and angles in rad"
        )
    values = values.expand(count, 6)
    return Pose(values[:, :3], euler_to_matrix(values[:, 3:]))


def read_case(options: dict[str, Any] | None, core: ScanCore) -> torch.Tensor | None:
    """Read `options["patient"]`: the seed of a patient of the environment, or one for each row."""
    if not options or "patient" not in options:
        return None
    if not isinstance(core.phantom, Ward):
        raise RacinesError(f"options['patient']: {core.task.id} has one heart and no patients")
    patients = np.asarray(options["patient"])
    if patients.dtype.kind not in "iu" or patients.shape not in ((), (core.num_envs,)):
        raise RacinesError(
            f"options['patient'] is {options['patient']!r}: give a patient's seed, or a list of "
            f"{core.num_envs}, one a row"
        )
    return core.phantom.case_of(np.broadcast_to(patients, core.num_envs).tolist())


def read_seeds(seed: Any, count: int) -> int | torch.Tensor | None:
    """Turn Gymnasium's seed of a vector environment into one integer or (count,) int64."""
    if seed is None:
        return None
    array = np.asarray(seed)
    if array.dtype.kind not in "iu" or array.shape not in ((), (count,)):
        raise RacinesError(f"seed {seed!r}: give one integer, or a list of {count}, one a row")
    return int(array) if array.ndim == 0 else torch.as_tensor(array.astype(np.int64))


class Scan:
    """A core behind a Gymnasium environment, single or of many rows, and its pictures."""

    def __init__(
        self, view: str, rows: int | None, render_mode: str | None, settings: dict[str, Any]
    ) -> None:
        """Build the core, of one row without a number of rows; settings as of `make_core`."""
        if render_mode not in (None, "rgb_array"):
            raise RacinesError(f"unknown render_mode {render_mode!r}: use 'rgb_array'")
        self.core = make_core(view, 1 if rows is None else rows, **settings)
        self._alone, self._mode, self._seeded = rows is None, render_mode, False
        self._history: History | None = None

    def space(self) -> spaces.Space[Any]:
        """Return the space of one row's observation; images are (128, 128, 1), channels last."""
        image = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 1), np.uint8)
        params = spaces.Box(-1.0, 1.0, (PARAMS_SIZE,), np.float32)
        seen: dict[str, spaces.Space[Any]] = {"image": image, "params": params}
        if self.core.observation != "multimodal":
            seen = {self.core.observation: seen[self.core.observation]}
        if self.core.robot.joints and "params" in seen:
            turn = 2.0 * np.pi
            seen["joints"] = spaces.Box(-turn, turn, (self.core.robot.joints,), np.float32)
        if self.core.task.any_view:
            seen["goal"] = spaces.Box(0.0, 1.0, (len(self.core.phantom.views),), np.float32)
        if self.core.masks:
            seen["action_mask"] = spaces.MultiBinary(len(ACTIONS))
        return spaces.Dict(seen) if len(seen) > 1 else seen[self.core.observation]

    def reset(self, env: Any, seed: Any, options: dict[str, Any] | None) -> Any:
        """Start episodes and return what is seen; without any seed yet, `env` draws one."""
        if seed is None and not self._seeded:
            seed = int(env.np_random.integers(2**31))
        pose, case = read_pose(options, self.core.num_envs), read_case(options, self.core)
        seen = self.core.reset(seed, pose=pose, case=case)
        self._seeded = True
        self._note()
        return self._arrays(seen)

    def step(self, actions: torch.Tensor, **how: Any) -> Transition:
        """Take (N,) actions, `how` being of `ScanCore.step`; what is seen is given as arrays."""
        actions = actions.to(self.core.device)
        given = self.core.step(actions, **how)
        self._note(actions)
        return given._replace(observation=self._arrays(given.observation))

    def edge_info(self) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Return (K,) infos of an episode's first and last observation alone, and those K rows."""
        rows = (self.core.state.done | (self.core.state.steps == 0)).nonzero().squeeze(1)
        if not len(rows):
            return {}, rows
        metres, radians = self.core.view_error(rows)
        return {"view_position_error": metres, "view_rotation_error": radians}, rows

    def draw(self) -> tuple[np.ndarray, ...] | None:
        """Return a (540, 960, 3) uint8 picture a row; None without a render mode."""
        if self._mode is None:
            return None
        if self._history is None:
            raise RacinesError("render before reset: call reset first")
        rows = range(self.core.num_envs)
        return tuple(compose(self.core, row, self._history) for row in rows)

    def _note(self, actions: torch.Tensor | None = None) -> None:
        """Remember the step or the reset that the core has just taken, if it is to be drawn."""
        if self._mode is not None:
            self._history = self._history or History(self.core.num_envs)
            self._history.note(self.core, actions)

    def _arrays(self, seen: dict[str, torch.Tensor]) -> Any:
        """Turn observations into (copied) arrays as the space wants them."""
        arrays = {name: value.cpu().numpy().copy() for name, value in seen.items()}
        if "action_mask" in arrays:
            arrays["action_mask"] = arrays["action_mask"].astype(np.int8)
        if "image" in arrays:
            arrays["image"] = arrays["image"][..., None]
        if self._alone:
            arrays = {name: values[0] for name, values in arrays.items()}
        return arrays if len(arrays) > 1 else arrays[self.core.observation]


class GymScanEnv(gymnasium.Env[Any, Any]):
    """Find a standard view with one probe."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, view: str, render_mode: str | None = None, **settings: Any) -> None:
        """Build the task of a view; settings: those of `racines_envs.worlds.making.make_core`."""
        self._scan = Scan(view, None, render_mode, settings)
        self.core, self.render_mode = self._scan.core, render_mode
        self.observation_space = self._scan.space()
        self.action_space = action_space(self.core)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode, at `options["pose"]` (6 values, m and rad) if given.

        A task on patients also takes `options["patient"]`, the seed of one of its patients.

        With a seed this is the first episode of that seed; without, the next one.
        """
        super().reset(seed=seed)
        return self._scan.reset(self, seed, options), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take one of the 13 actions, an integer 0-12, or a twist; refused after the end."""
        row = read_actions(action, self.core)
        seen, reward, ended, cut = self._scan.step(row, strict=True)
        return seen, float(reward), bool(ended), bool(cut), self._info()

    def render(self) -> Any:
        """Return the picture of `racines_envs.apis.rendering.compose`, (540, 960, 3) uint8."""
        frames = self._scan.draw()
        return None if frames is None else frames[0]

    def _info(self) -> dict[str, Any]:
        told = self.core.info(view_error=False) | self._scan.edge_info()[0]
        return {name: value.item() for name, value in told.items()}


class VectorScanEnv(VectorEnv[Any, Any, Any]):
    """N probes on one phantom.

    Row i with seed s is exactly `GymScanEnv` with seed s + i. A row that ends starts its next
    episode in the next step, whose action it ignores (`AutoresetMode.NEXT_STEP`, Gymnasium's
    default: so one step draws one image a row and the last observation is never lost).
    """

    metadata = GymScanEnv.metadata | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self, view: str, num_envs: int = 1, render_mode: str | None = None, **settings: Any
    ) -> None:
        """Build N rows of a view's task; settings as for `GymScanEnv`."""
        self._scan = Scan(view, num_envs, render_mode, settings)
        self.core, self.render_mode, self.num_envs = self._scan.core, render_mode, num_envs
        self.single_observation_space = self._scan.space()
        self.single_action_space = action_space(self.core)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start N episodes, of seeds s, s + 1, … for an integer s, or of one seed a row."""
        seeds = read_seeds(seed, self.num_envs)
        super().reset(seed=seeds if isinstance(seeds, int) else None)
        return self._scan.reset(self, seeds, options), self._infos()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take (N,) actions, integers 0-12, or (N, 6) twists."""
        taken = read_actions(actions, self.core)
        seen, reward, *ends = self._scan.step(taken, autoreset=True)
        ended, cut = (value.cpu().numpy() for value in ends)
        return seen, reward.double().cpu().numpy(), ended, cut, self._infos()

    def render(self) -> tuple[Any, ...] | None:
        """Return N pictures of `racines_envs.apis.rendering.compose`, (540, 960, 3) uint8 each."""
        return self._scan.draw()

    def _infos(self) -> dict[str, Any]:
        """Return the infos with Gymnasium's masks of presence."""
        told = self.core.info(view_error=False)
        infos = {name: value.cpu().numpy().copy() for name, value in told.items()}
        infos |= {f"_{name}": np.ones(self.num_envs, dtype=np.bool_) for name in told}
        edge, rows = self._scan.edge_info()
        present = np.zeros(self.num_envs, dtype=np.bool_)
        present[rows.cpu().numpy()] = True
        for name, values in edge.items():
            infos[name] = np.zeros(self.num_envs)
            infos[name][present] = values.cpu().numpy()
            infos[f"_{name}"] = present.copy()
        return infos
