"""The tasks in Gymnasium: one environment, and N rows that take one step for all."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_envs.apis.reading import (
    action_space,
    read_actions,
    read_case,
    read_mode,
    read_pose,
    read_seeds,
    take_mask,
)
from racines_envs.apis.rendering import History, compose
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE
from racines_envs.task.state import Transition
from racines_envs.worlds.making import check_settings, make_core


class Scan:
    """A core behind a Gymnasium environment, single or of many rows, and its pictures."""

    def __init__(
        self, view: str, rows: int | None, render_mode: str | None, settings: dict[str, Any]
    ) -> None:
        """Build the core, of one row without a number of rows; settings as of `make_core`."""
        if render_mode not in (None, "rgb_array"):
            raise RacinesError(f"unknown render_mode {render_mode!r}: use 'rgb_array'")
        self.core = make_core(view, 1 if rows is None else rows, **check_settings(settings))
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

    def reset(
        self, env: Any, seed: Any, options: dict[str, Any] | None,
        mask: torch.Tensor | None = None,
    ) -> Any:  # fmt: skip
        """Start episodes and return what all see; without any seed yet, `env` draws one.

        Only the rows of an (N,) bool `mask` start, all without one.
        """
        if seed is None and not self._seeded:
            seed = int(env.np_random.integers(2**31))
        pose, case = read_pose(options, self.core.num_envs), read_case(options, self.core)
        rows = None if mask is None else mask.to(self.core.device)
        seen = self.core.reset(seed, rows, pose, case)
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
    """N probes on one phantom, or on the patients of a ward.

    Row i with seed s is exactly `GymScanEnv` with seed s + i. When a row that ended begins anew is
    the `autoreset_mode`'s to say, as Gymnasium's own vector environments understand it:

        NEXT_STEP  in the next step, whose action it ignores (the default: one image a row a step)
        SAME_STEP  at once: its last observation and infos are `final_obs` and `final_info`
        DISABLED   when `reset(options={"reset_mask": …})` says so; a step before is refused
    """

    metadata = GymScanEnv.metadata | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self, view: str, num_envs: int = 1, render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **settings: Any,
    ) -> None:  # fmt: skip
        """Build N rows of a view's task; settings as for `GymScanEnv`."""
        self.autoreset_mode = read_mode(autoreset_mode)
        self.metadata = GymScanEnv.metadata | {"autoreset_mode": self.autoreset_mode}
        self._scan = Scan(view, num_envs, render_mode, settings)
        self.core, self.render_mode, self.num_envs = self._scan.core, render_mode, num_envs
        self.single_observation_space = self._scan.space()
        self.single_action_space = action_space(self.core)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start N episodes, of seeds s, s + 1, … for an integer s, or of one seed a row.

        Options are those of `GymScanEnv`, and Gymnasium's `reset_mask`: (N,) bool, the rows that
        start. What the others see is returned as it was, and nothing in the infos is of them.
        """
        seeds = read_seeds(seed, self.num_envs)
        super().reset(seed=seeds if isinstance(seeds, int) else None)
        mask, rest = take_mask(options, self.num_envs)
        seen = self._scan.reset(self, seeds, rest, mask)
        return seen, self._infos(None if mask is None else mask.numpy())

    def step(
        self, actions: Any, rows: torch.Tensor | None = None
    ) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take (N,) actions, integers 0-12, or (N, 6) twists; only (K,) `rows` move, or all."""
        taken, mode = read_actions(actions, self.core), self.autoreset_mode
        seen, reward, *ends = self._scan.step(
            taken,
            autoreset=mode is AutoresetMode.NEXT_STEP,
            strict=mode is AutoresetMode.DISABLED,
            rows=rows,
        )
        ended, cut = (value.cpu().numpy() for value in ends)
        last: dict[str, Any] = {}
        if mode is AutoresetMode.SAME_STEP and (ended | cut).any():
            seen, last = self._restart(seen, ended | cut)
        return seen, reward.double().cpu().numpy(), ended, cut, last | self._infos()

    def render(self) -> tuple[Any, ...] | None:
        """Return N pictures of `racines_envs.apis.rendering.compose`, (540, 960, 3) uint8 each."""
        return self._scan.draw()

    def _restart(self, seen: Any, done: np.ndarray) -> tuple[Any, dict[str, Any]]:
        """Start the next episodes of the rows that are done; return what is seen, and was last."""
        final = np.full(self.num_envs, None, dtype=object)
        for row, each in enumerate(iterate(self.observation_space, seen)):
            if done[row]:
                final[row] = each
        told = {"final_obs": final, "final_info": self._infos(done)}
        last = told | {f"_{name}": done.copy() for name in told}
        return self._scan.reset(self, None, None, torch.as_tensor(done)), last

    def _infos(self, rows: np.ndarray | None = None) -> dict[str, Any]:
        """Return the infos with Gymnasium's masks of presence, of (N,) bool rows or of all."""
        here = np.ones(self.num_envs, dtype=np.bool_) if rows is None else rows
        told = self.core.info(view_error=False)
        infos: dict[str, Any] = {}
        for name, value in told.items():
            array = value.cpu().numpy().copy()
            if rows is not None:
                array[~here] = 0
            infos[name], infos[f"_{name}"] = array, here.copy()
        edge, at = self._scan.edge_info()
        present = np.zeros(self.num_envs, dtype=np.bool_)
        present[at.cpu().numpy()] = True
        for name, values in edge.items():
            array = np.zeros(self.num_envs)
            array[present] = values.cpu().numpy()
            infos[name] = np.where(here, array, 0.0)
            infos[f"_{name}"] = present & here
        return infos
