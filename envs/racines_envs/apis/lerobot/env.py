"""The tasks as LeRobot's evaluation wants them: pictures of three channels, state, velocities.

`make_env` is what an EnvHub folder's `env.py` has to offer (`racines export envhub` writes one). An
observation is `{"pixels": {"ultrasound": …}, "agent_pos": …}`, which LeRobot calls
`observation.images.ultrasound` and `observation.state`, an action the commanded velocity: all three
as the export of the same format writes them (`formats`), so that a policy trained on an export acts
here. Where an arm carries the probe (`robot`) there are also its `joints`, rad, which LeRobot calls
`observation.joints`. Nothing of LeRobot is imported.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.schema import PARAMETERS
from racines_envs.apis.gym_env import GymScanEnv
from racines_envs.apis.lerobot.formats import (
    CAMERA,
    JOINTS,
    POSE,
    RECORDED,
    TASK,
    check_format,
    twist_of,
)
from racines_envs.apis.reading import OPTIONS
from racines_envs.task.motion import VELOCITY, Velocity
from racines_envs.task.sensing import box_of, encode_pose


class LeRobotEnv(gymnasium.Env[Any, Any]):
    """One probe that is moved by velocities, m/s and rad/s, of its own frame or the base's."""

    metadata: dict[str, Any] = GymScanEnv.metadata

    def __init__(self, view: str = "SC", format: str = RECORDED, **settings: Any) -> None:
        """Build the task of a view; settings as for `racines_envs.worlds.making.make_core`.

        Raises:
            RacinesError: an unknown format or task, or one whose goal is drawn for each episode.
        """
        self._own = check_format(format) == TASK
        own: dict[str, Any] = {"observation": "image", "reward": "oracle", "action": VELOCITY}
        self._env = GymScanEnv(view, render_mode="rgb_array", **(own | settings))
        core = self._env.core
        motion, task = core.motion, core.task
        assert isinstance(motion, Velocity)
        if task.any_view:
            raise RacinesError(f"{task.name}: LeRobot's policies see no goal: name a view")
        self._limits = motion.limits.cpu().numpy()
        self._box = tuple(x.cpu() for x in box_of(core.phantom.workspace))
        self.render_mode = "rgb_array"
        self.task, self._max_episode_steps = task.name, task.max_steps
        self.task_description = f"Move the probe until the image shows the {task.view} view."
        shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
        pixels = spaces.Dict({CAMERA: spaces.Box(0, 255, shape, np.uint8)})
        most, count = (1.0, len(POSE)) if self._own else (np.inf, len(PARAMETERS))
        state = spaces.Box(-most, most, (count,), np.float32)
        seen: dict[str, spaces.Space[Any]] = {"pixels": pixels, "agent_pos": state}
        if core.robot.joints:
            seen[JOINTS] = spaces.Box(-np.inf, np.inf, (core.robot.joints,), np.float32)
        self.observation_space = spaces.Dict(seen)
        high = self._limits
        if not self._own:
            # Whichever way the probe is turned: its limits along each axis hold at every step.
            high = np.sqrt(3.0) * high
        high = high.astype(np.float32)
        self.action_space = spaces.Box(-high, high, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; of `options` those that LeRobot has for itself are left aside."""
        super().reset(seed=seed)
        own = {key: value for key, value in (options or {}).items() if key in OPTIONS}
        image, info = self._env.reset(seed=seed, options=own or None)
        return self._seen(image), self._told(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take a velocity, six numbers; it is cut at the probe's limits in the probe's frame."""
        twist = np.asarray(action, np.float32)
        if not self._own:
            turned = self._env.core.state.rotation.float().cpu()
            twist = twist_of(torch.from_numpy(twist)[None], turned)[0].numpy()
        cut = np.clip(twist, -self._limits, self._limits)
        image, reward, ended, out, info = self._env.step(cut)
        return self._seen(image), reward, ended, out, self._told(info)

    def render(self) -> Any:
        """Return the picture of `racines_envs.apis.rendering.compose`, (540, 960, 3) uint8."""
        return self._env.render()

    def _seen(self, image: np.ndarray) -> dict[str, Any]:
        core = self._env.core
        if self._own:
            state = encode_pose(core.told_pose().to("cpu"), *self._box)[0].float().numpy()
        else:
            state = core.parameters[0].cpu().numpy().astype(np.float32)
        seen = {"pixels": {CAMERA: np.repeat(image, 3, axis=-1)}, "agent_pos": state}
        if core.robot.joints:
            seen[JOINTS] = core.state.joints[0].cpu().numpy().astype(np.float32)
        return seen

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        return info | {"is_success": bool(info["success"])}


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None, *,
    views: tuple[str, ...] = ("SC",), **settings: Any,
) -> dict[str, dict[int, VectorEnv[Any, Any, Any]]]:  # fmt: skip
    """Return `{"racines": {place: N environments of a view}}`, as LeRobot's EnvHub asks for.

    Args:
        n_envs: Environments side by side.
        use_async_envs: Whether each has a process of its own.
        cfg: LeRobot's configuration; nothing of it is needed.
        views: Tasks, one after the other.
        settings: As for `LeRobotEnv`.
    """
    kind: Any = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    made = {}
    for place, view in enumerate(views):
        one = _Maker(view, settings)
        made[place] = kind([one] * n_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    return {"racines": made}


class _Maker:
    """Makes an environment; goes to other processes as it is."""

    def __init__(self, view: str, settings: dict[str, Any]) -> None:
        self.view, self.settings = view, settings

    def __call__(self) -> LeRobotEnv:
        return LeRobotEnv(self.view, **self.settings)
