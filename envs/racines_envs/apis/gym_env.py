"""`racines/<VIEW>-v0` as one Gymnasium environment: a batch of one row of the core."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, euler_to_matrix
from racines_data.imaging import IMAGE_SIZE
from racines_envs.apis.rendering import History, compose_all
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import OBSERVATIONS, PARAMS_SIZE, ScanCore
from racines_envs.worlds.making import make_core

RENDER_FPS = 10


def observation_space(observation: str) -> spaces.Space[Any]:
    """Return the space of one observation; images are (128, 128, 1), channels last."""
    image = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 1), np.uint8)
    params = spaces.Box(-1.0, 1.0, (PARAMS_SIZE,), np.float32)
    known: dict[str, spaces.Space[Any]] = {
        "image": image,
        "params": params,
        "multimodal": spaces.Dict({"image": image, "params": params}),
    }
    if observation not in known:
        raise RacinesError(
            f"unknown observation {observation!r}: choose one of {', '.join(OBSERVATIONS)}"
        )
    return known[observation]


def to_numpy(core: ScanCore, seen: dict[str, torch.Tensor]) -> Any:
    """Turn observations of N rows into (copied) arrays as the vector space wants them."""
    arrays = {name: value.cpu().numpy().copy() for name, value in seen.items()}
    if "image" in arrays:
        arrays["image"] = arrays["image"][..., None]
    return arrays if core.observation == "multimodal" else arrays[core.observation]


def read_actions(actions: Any) -> torch.Tensor:
    """Turn actions of any kind of sequence into a tensor of integers.

    Raises:
        RacinesError: they are not integers.
    """
    try:
        array = np.asarray(actions)
    except ValueError as error:
        raise RacinesError(f"actions {actions!r} are ragged: give integers 0-12") from error
    if array.dtype.kind not in "iu":
        raise RacinesError(f"action {actions!r} is no integer: give integers 0-12")
    return torch.as_tensor(array.astype(np.int64))


def read_pose(options: dict[str, Any] | None, count: int) -> Pose | None:
    """Read `options["pose"]`: (6,) or (count, 6) position m and extrinsic xyz angles rad.

    Raises:
        RacinesError: an unknown option, or values of another shape.
    """
    options = options or {}
    unknown = set(options) - {"pose"}
    if unknown:
        raise RacinesError(f"unknown reset option {sorted(unknown)[0]!r}: known is 'pose'")
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


def check_render_mode(render_mode: str | None) -> str | None:
    """Return the mode if it is `rgb_array` or none."""
    if render_mode not in (None, "rgb_array"):
        raise RacinesError(f"unknown render_mode {render_mode!r}: use 'rgb_array'")
    return render_mode


def edge_info(core: ScanCore) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Return the infos that stand at the first and the last observation of an episode alone.

    Returns:
        (K,) values of the K rows that are there, none where no row is; and those rows.
    """
    rows = (core.state.done | (core.state.steps == 0)).nonzero().squeeze(1)
    if not len(rows):
        return {}, rows
    metres, radians = core.view_error(rows)
    return {"view_position_error": metres, "view_rotation_error": radians}, rows


class Renderer:
    """What `render()` of both Gymnasium environments does; idle without a render mode."""

    def __init__(self, core: ScanCore, render_mode: str | None) -> None:
        """Watch a core."""
        self._core, self._mode = core, render_mode
        self._history: History | None = None

    def note(self, actions: torch.Tensor | None = None) -> None:
        """Remember the step or the reset that the core has just taken."""
        if self._mode is not None:
            self._history = self._history or History(self._core.num_envs)
            self._history.note(self._core, actions)

    def draw(self) -> tuple[np.ndarray, ...] | None:
        """Return a (540, 960, 3) uint8 picture a row; None without a render mode.

        Raises:
            RacinesError: there has been no reset.
        """
        if self._mode is None:
            return None
        if self._history is None:
            raise RacinesError("render before reset: call reset first")
        return compose_all(self._core, self._history)


class GymScanEnv(gymnasium.Env[Any, np.int64]):
    """Find a standard view with one probe."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS}

    def __init__(self, view: str, render_mode: str | None = None, **settings: Any) -> None:
        """Build the task of a view; settings: those of `racines_envs.worlds.making.make_core`."""
        self.render_mode = check_render_mode(render_mode)
        self.observation_space = observation_space(settings.get("observation", "image"))
        self.action_space = spaces.Discrete(len(ACTIONS))
        self.core = make_core(view, 1, **settings)
        self._renderer = Renderer(self.core, render_mode)
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode, at `options["pose"]` (6 values, m and rad) if given.

        With a seed this is the first episode of that seed; without, the next one.
        """
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**31))
        self._seeded = True
        seen = self.core.reset(seed, pose=read_pose(options, 1))
        self._renderer.note()
        return self._first(seen), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take one of the 13 actions.

        Raises:
            RacinesError: the action is not an integer 0-12, or the episode has ended.
        """
        row = read_actions(action).reshape(-1).to(self.core.device)
        seen, reward, ended, cut = self.core.step(row, strict=True)
        self._renderer.note(row)
        return self._first(seen), float(reward), bool(ended), bool(cut), self._info()

    def render(self) -> Any:
        """Return the picture of `racines_envs.apis.rendering.compose`, (540, 960, 3) uint8.

        Raises:
            RacinesError: there has been no reset.
        """
        frames = self._renderer.draw()
        return None if frames is None else frames[0]

    def _first(self, seen: dict[str, torch.Tensor]) -> Any:
        arrays = to_numpy(self.core, seen)
        if isinstance(arrays, dict):
            return {name: value[0] for name, value in arrays.items()}
        return arrays[0]

    def _info(self) -> dict[str, Any]:
        info = {name: value.item() for name, value in self.core.info(view_error=False).items()}
        return info | {name: value.item() for name, value in edge_info(self.core)[0].items()}
