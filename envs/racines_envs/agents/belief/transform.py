"""A TorchRL environment whose images are looked at once, by a `Sight`."""

from typing import Any

import torch

from racines_data.extras import absent
from racines_envs.agents.belief.sight import Sight
from racines_envs.agents.planner import PlannerAgent
from racines_envs.task.actions import ACTIONS

try:
    from tensordict import TensorDictBase
    from torchrl.data import Categorical, Composite, TensorSpec, Unbounded
    from torchrl.envs import EnvBase, Transform, TransformedEnv
except ModuleNotFoundError as error:
    raise absent(str(error.name), "training ppo-belief") from error

SEEN = ("image", "params", "goal")
TAUGHT = "taught"
"""What the planner would do, which a policy is taught by and never shown."""


class SeenThrough(Transform):
    """Puts `features`, what has been seen in each row's episode so far, in place of `image`.

    And `taught`, if it is asked for, the steps of the planner, who knows the truth.
    """

    def __init__(self, sight: Sight, core: Any, taught: bool) -> None:
        super().__init__()
        self._episodes, self._size = sight.begin(core), sight.size
        self._planner = PlannerAgent() if taught else None
        if self._planner is not None:
            self._planner.attach(core)

    def _see(self, seen: TensorDictBase, rows: torch.Tensor | None = None) -> TensorDictBase:
        given = {key: each for key in SEEN if (each := seen.get(key, None)) is not None}
        seen["features"] = self._episodes.see(given, rows)
        if self._planner is not None:
            seen[TAUGHT] = self._planner.act({}, torch.empty(0))
        return seen.exclude("image")

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._see(next_tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = None if tensordict is None else tensordict.get("_reset", None)
        return self._see(tensordict_reset, None if rows is None else rows.reshape(-1))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Return the specification with the features, without the images."""
        assert isinstance(observation_spec, Composite)
        spec = observation_spec.clone()
        shape = torch.Size([*spec.shape, self._size])
        spec["features"] = Unbounded(shape, dtype=torch.float32, device=spec.device)
        if self._planner is not None:
            kind = {"dtype": torch.int64, "device": spec.device}
            spec[TAUGHT] = Categorical(len(ACTIONS), spec.shape, **kind)
        del spec["image"]
        return spec


def seen_through(env: EnvBase, sight: Sight, taught: bool = False) -> EnvBase:
    """Return an environment seen through a sight; if `taught`, with the steps of the planner."""
    return TransformedEnv(env, SeenThrough(sight, env.core, taught))  # pyright: ignore
