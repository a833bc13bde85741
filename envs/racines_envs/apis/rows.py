"""Rows of a vector environment one by one, for libraries that ask each environment by itself."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch

from racines_envs.apis.gym_env import VectorScanEnv


def by_row(infos: Mapping[str, Any], count: int) -> list[dict[str, Any]]:
    """Return Gymnasium's infos of `count` rows as a dictionary a row, of plain numbers.

    What a mask says is not there is left out; so are `final_obs` and `final_info`.
    """
    names = [name for name in infos if f"_{name}" in infos and not name.startswith("final_")]
    whole = [name for name in names if infos[f"_{name}"].all()]
    columns = [infos[name].tolist() for name in whole]
    rows = [dict(zip(whole, values, strict=True)) for values in zip(*columns, strict=True)]
    rows = rows or [{} for _ in range(count)]
    for name in names:
        for row in () if name in whole else infos[f"_{name}"].nonzero()[0]:
            rows[row][name] = infos[name][row].item()
    return rows


def action_masks(envs: VectorScanEnv, rows: Iterable[int]) -> list[np.ndarray]:
    """Return which of the thirteen steps may go, (13,) bool a row: by workspace and force."""
    return list(
        envs.core.options(torch.as_tensor(list(rows), device=envs.core.device))[1].cpu().numpy()
    )


class Row:
    """One row as if it were an environment; what it has not itself is the vector environment's."""

    def __init__(self, envs: VectorScanEnv, row: int) -> None:
        """Take a vector environment and the number of a row."""
        self._envs, self._row = envs, row
        self.observation_space = envs.single_observation_space
        self.action_space = envs.single_action_space

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._envs, name)

    @property
    def unwrapped(self) -> "Row":
        """Itself."""
        return self

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode of this row alone; as `GymScanEnv.reset`."""
        count = self._envs.num_envs
        mask = np.arange(count) == self._row
        seeds = None if seed is None else [seed] * count
        seen, infos = self._envs.reset(seed=seeds, options={**(options or {}), "reset_mask": mask})
        return row_of(seen, self._row), by_row(infos, count)[self._row]

    def render(self) -> np.ndarray | None:
        """Return the picture of this row, (540, 960, 3) uint8; None without a render mode."""
        pictures = self._envs.render()
        return None if pictures is None else pictures[self._row]

    def action_masks(self) -> np.ndarray:
        """Return which of the thirteen steps may go, (13,) bool."""
        return action_masks(self._envs, [self._row])[0]


def row_of(seen: Any, rows: Any) -> Any:
    """Return the observations of a row, or of several, from those of all."""
    if isinstance(seen, Mapping):
        return {name: value[rows] for name, value in seen.items()}
    return seen[rows]
