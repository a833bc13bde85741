"""The tasks as a vector environment of Tianshou: N rows of one core, not N environments.

envs = TianshouScanEnv("racines/SC-v0", num_envs=64, observation="params", reward="shaped")
Collector(policy, envs, VectorReplayBuffer(20_000, len(envs)))
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from racines_data.errors import RacinesError
from racines_envs.apis.rows import Row, by_row, row_of

try:
    from tianshou.env import BaseVectorEnv  # pyright: ignore[reportMissingImports]
except ModuleNotFoundError as error:
    raise RacinesError(f"TianshouScanEnv needs {error.name}: pip install tianshou") from error


class TianshouScanEnv(BaseVectorEnv):
    """N rows of any task of ours, by its Gymnasium id.

    Its collectors step and reset the rows that they name; the others stay as they are.
    """

    def __init__(self, task: str, num_envs: int = 64, **settings: Any) -> None:
        """Build N rows of a task, `racines/SC-v0`; settings as for `gymnasium.make_vec`."""
        envs = gymnasium.make_vec(
            task, num_envs=num_envs, autoreset_mode=AutoresetMode.DISABLED, **settings
        )
        self.envs: Any = envs.unwrapped
        self.workers = [Row(self.envs, row) for row in range(num_envs)]
        # What the collectors ask of a vector environment that waits for all of its rows.
        self.env_num = self.wait_num = num_envs
        self.is_async, self.is_closed, self.timeout = False, False, None
        self.waiting_id: list[int] = []
        self.ready_id = list(range(num_envs))

    def reset(self, env_id: Any = None, **kwargs: Any) -> tuple[Any, np.ndarray]:
        """Start episodes of the rows named, or of all; one `seed` and `options` are each row's."""
        rows = np.asarray(self._wrap_id(env_id))
        seed = kwargs.pop("seed", None)
        options = dict(kwargs.pop("options", None) or {})
        if len(rows) < self.env_num:
            options["reset_mask"] = np.isin(np.arange(self.env_num), rows)
        seeds = None if seed is None else [seed] * self.env_num
        seen, infos = self.envs.reset(seed=seeds, options=options)
        return self._taken(seen, rows), self._told(infos, rows)

    def step(self, action: Any, id: Any = None) -> tuple[Any, ...]:
        """Step the K rows named, or all, by (K,) or (K, 6) actions.

        Returns (K, …) observations, (K,) rewards, terminated, truncated and infos.
        """
        rows = np.asarray(self._wrap_id(id))
        given = np.asarray(action)
        everyone = np.zeros((self.env_num, *given.shape[1:]), given.dtype)
        everyone[rows] = given
        chosen = None
        if len(rows) < self.env_num:
            chosen = torch.as_tensor(rows, device=self.envs.core.device)
        seen, *paid, infos = self.envs.step(everyone, rows=chosen)
        told = self._told(infos, rows)
        for row, each in zip(rows.tolist(), told, strict=True):
            each["env_id"] = row
        return self._taken(seen, rows), *(column[rows] for column in paid), told

    def seed(self, seed: int | list[int] | None = None) -> list[Any]:
        """Start the first episodes of the seeds s, s + 1, …, or of one a row; return the seeds."""
        if isinstance(seed, int):
            seed = [seed + row for row in range(self.env_num)]
        self.envs.reset(seed=seed)
        return [None] * self.env_num if seed is None else [[each] for each in seed]

    def render(self, **_: Any) -> list[Any]:
        """Return N pictures, (540, 960, 3) uint8 each; none without a render mode."""
        return list(self.envs.render() or ())

    def get_env_attr(self, key: str, id: Any = None) -> list[Any]:
        """Return an attribute of each row named: its own, or else what all rows share."""
        return [getattr(self.workers[row], key) for row in self._wrap_id(id)]

    def set_env_attr(self, key: str, value: Any, id: Any = None) -> None:
        """Set an attribute of each row named, which `get_env_attr` returns."""
        for row in self._wrap_id(id):
            setattr(self.workers[row], key, value)

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()
        self.is_closed = True

    def _taken(self, seen: Any, rows: np.ndarray) -> Any:
        """Return what (K,) rows see; of dictionaries an array of K, as Tianshou stacks them."""
        if not isinstance(seen, dict):
            return seen[rows]
        return np.array([row_of(seen, row) for row in rows])

    def _told(self, infos: dict[str, Any], rows: np.ndarray) -> np.ndarray:
        each = by_row(infos, self.env_num)
        return np.array([each[row] for row in rows])
