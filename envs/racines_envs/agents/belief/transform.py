"""A TorchRL environment whose images are looked at once, by a `Sight`."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, Transform, TransformedEnv

from racines_envs.agents.belief.sight import Sight

SEEN = ("image", "params", "goal")


class SeenThrough(Transform):
    """Puts `features`, what has been seen in each row's episode so far, in place of `image`."""

    def __init__(self, sight: Sight, core: Any) -> None:
        super().__init__()
        self._episodes, self._size = sight.begin(core), sight.size

    def _see(self, seen: TensorDictBase, rows: torch.Tensor | None = None) -> TensorDictBase:
        given = {key: each for key in SEEN if (each := seen.get(key, None)) is not None}
        seen["features"] = self._episodes.see(given, rows)
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
        del spec["image"]
        return spec


def seen_through(env: EnvBase, sight: Sight) -> EnvBase:
    """Return an environment seen through a sight."""
    return TransformedEnv(env, SeenThrough(sight, env.core))  # pyright: ignore
