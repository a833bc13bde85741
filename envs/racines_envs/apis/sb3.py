"""The tasks as a `VecEnv` of Stable-Baselines3: N rows of one core, not N environments.

env = SB3ScanEnv("racines/SC-v0", num_envs=64, observation="params", reward="shaped")
PPO("MlpPolicy", env).learn(100_000)
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from racines_data.errors import RacinesError
from racines_envs.apis.rows import Row, action_masks, by_row

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices
except ModuleNotFoundError as error:
    raise RacinesError(f"SB3ScanEnv needs {error.name}: pip install stable-baselines3") from error


class SB3ScanEnv(VecEnv):
    """N rows of any task of ours, by its Gymnasium id.

    A row that ends begins anew in the same step: `terminal_observation` in its info is the last
    observation, `TimeLimit.truncated` says that it was cut and has not ended. Row i is, bit by bit,
    environment i of a `DummyVecEnv` with the same seeds.
    """

    def __init__(self, task: str, num_envs: int = 64, **settings: Any) -> None:
        """Build N rows of a task, `racines/SC-v0`; settings as for `gymnasium.make_vec`."""
        envs = gymnasium.make_vec(
            task, num_envs=num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **settings
        )
        self.envs: Any = envs.unwrapped
        self._rows = [Row(self.envs, row) for row in range(num_envs)]
        self._actions: Any = None
        super().__init__(num_envs, envs.single_observation_space, envs.single_action_space)
        self.metadata = self.envs.metadata

    def reset(self) -> Any:
        """Start all episodes, with the seeds and options set before; return (N, …) observations."""
        seeds = None if None in self._seeds else self._seeds
        seen, infos = self.envs.reset(seed=seeds, options=_together(self._options))
        self.reset_infos = by_row(infos, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next `step_wait`, (N,) or (N, 6)."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Return (N, …) observations, (N,) float32 rewards, (N,) bool ends and N infos."""
        seen, rewards, ended, cut, infos = self.envs.step(self._actions)
        done, rows = ended | cut, by_row(infos, self.num_envs)
        if done.any():
            last = by_row(infos["final_info"], self.num_envs)
            for row in done.nonzero()[0]:
                self.reset_infos[row] = rows[row]
                rows[row] = last[row] | {"terminal_observation": infos["final_obs"][row]}
        for row, timed_out in zip(rows, (cut & ~ended).tolist(), strict=True):
            row["TimeLimit.truncated"] = timed_out
        return seen, rewards.astype(np.float32), done, rows

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return N pictures, (540, 960, 3) uint8 each; None without `render_mode="rgb_array"`."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each row: its own, or else what all rows share."""
        return [getattr(row, attr_name) for row in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each row, which `get_attr` returns; the task stays as it is."""
        for row in self._chosen(indices):
            setattr(row, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:  # fmt: skip
        """Call a method of each row: `reset`, `render`, `action_masks`, or what all rows share."""
        if method_name == "action_masks":  # of all rows at once, as MaskablePPO asks at each step
            return action_masks(self.envs, self._get_indices(indices))
        rows = self._chosen(indices)
        return [getattr(row, method_name)(*method_args, **method_kwargs) for row in rows]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each row: none is in a wrapper."""
        return [False for _ in self._get_indices(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[Row]:
        return [self._rows[row] for row in self._get_indices(indices)]


def _together(options: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the options of N rows as one mapping of lists."""
    names = set(options[0])
    if any(set(each) != names for each in options):
        raise RacinesError("options: give those of all rows the same names, `pose`, `patient`")
    return {name: [each[name] for each in options] for name in names} or None
