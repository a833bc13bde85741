"""`racines/<VIEW>-v0` as a Gymnasium vector environment: N rows of the core, one step for all."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from racines_data.errors import RacinesError
from racines_envs.apis.gym_env import GymScanEnv, Scan, read_actions
from racines_envs.task.actions import ACTIONS


def read_seeds(seed: Any, count: int) -> int | torch.Tensor | None:
    """Turn Gymnasium's seed of a vector environment into one integer or (count,) int64."""
    if seed is None:
        return None
    array = np.asarray(seed)
    if array.dtype.kind not in "iu" or array.shape not in ((), (count,)):
        raise RacinesError(f"seed {seed!r}: give one integer, or a list of {count}, one a row")
    return int(array) if array.ndim == 0 else torch.as_tensor(array.astype(np.int64))


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
        """Build N rows of a view's task; settings as for `racines_envs.worlds.making.make_core`."""
        self._scan = Scan(view, num_envs, render_mode, settings)
        self.core, self.render_mode, self.num_envs = self._scan.core, render_mode, num_envs
        self.single_observation_space = self._scan.space()
        self.single_action_space = spaces.Discrete(len(ACTIONS))
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
        """Take (N,) actions.

        Raises:
            RacinesError: wrong shape or type, or an action outside 0-12.
        """
        seen, reward, *ends = self._scan.step(read_actions(actions), autoreset=True)
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
