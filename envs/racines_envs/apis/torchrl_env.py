"""The tasks as one natively batched TorchRL environment on the core."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from racines_data.imaging import IMAGE_SIZE
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE
from racines_envs.task.tasks import Task
from racines_envs.worlds.making import make_core
from racines_models.devices import resolve_device

_INFO = {"success": torch.bool, "steps": torch.int64, "return": torch.float32}


class ScanEnv(EnvBase):
    """N probes on one phantom; batch size (N,).

    Keys: `image` (N, 1, 128, 128) uint8, channels first (with an encoder, its `features` instead),
    and/or `params` (N, 9) float32; `action` (N,) int64; `reward`, `done`, `terminated`, `truncated`
    (N, 1); and under `info`, for curves and not for policies, `success` by the oracle, `steps` and
    `return` so far.
    """

    def __init__(
        self,
        view: str | Task,
        num_envs: int = 1,
        *,
        seed: int = 0,
        device: torch.device | str = "cpu",
        **settings: Any,
    ) -> None:
        """Build N rows of a task; settings as for `racines_envs.worlds.making.make_core`."""
        device = resolve_device(device)
        super().__init__(device=torch.device(device), batch_size=torch.Size([num_envs]))
        self.core = make_core(view, num_envs, device=device, **settings)
        self._make_specs(num_envs)
        self._start_seed: int | None = None
        self.set_seed(seed)

    def _make_specs(self, n: int) -> None:
        rows, column = torch.Size([n]), torch.Size([n, 1])
        image = torch.Size([n, 1, IMAGE_SIZE, IMAGE_SIZE])
        kinds: dict[str, Any] = {
            "image": lambda: Bounded(0, 255, image, dtype=torch.uint8),
            "params": lambda: Bounded(-1.0, 1.0, torch.Size([n, PARAMS_SIZE]), dtype=torch.float32),
        }
        names = list(kinds) if self.core.observation == "multimodal" else [self.core.observation]
        if self.core.encoder is not None:
            features = torch.Size([n, self.core.encoder.size])
            kinds["features"] = lambda: Unbounded(features, dtype=torch.float32)
            names = ["features", *names[1:]]
        info = {
            key: Binary(1, column, dtype=kind)
            if kind == torch.bool
            else Unbounded(column, dtype=kind)
            for key, kind in _INFO.items()
        }
        self.observation_spec = Composite(
            {name: kinds[name]() for name in names} | {"info": Composite(info, shape=rows)},
            shape=rows,
        )
        self.action_spec = Categorical(len(ACTIONS), rows, dtype=torch.int64)
        self.reward_spec = Unbounded(column)
        flag = Categorical(2, column, dtype=torch.bool)
        self.done_spec = Composite(
            {key: flag.clone() for key in ("done", "terminated", "truncated")}, shape=rows
        )
        self.to(self.device)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._start_seed = seed

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is not None:
            mask = mask.reshape(self.batch_size)
        seed, self._start_seed = self._start_seed, None
        self.core.reset(seed, mask=None if seed is not None else mask)
        done = self.core.state.done.unsqueeze(-1)
        flags = {"done": done, "terminated": done, "truncated": done}
        return self._pack(flags)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        _, reward, terminated, truncated = self.core.step(tensordict["action"])
        return self._pack(
            {
                "reward": reward.unsqueeze(-1),
                "done": self.core.state.done.unsqueeze(-1),
                "terminated": terminated.unsqueeze(-1),
                "truncated": truncated.unsqueeze(-1),
            }
        )

    def _pack(self, values: dict[str, Any]) -> TensorDictBase:
        """Join observations and info with the given entries."""
        seen = self.core.observe()
        if self.core.encoder is not None:
            del seen["image"]
        elif "image" in seen:
            seen["image"] = seen["image"].unsqueeze(1)
        info = {
            "success": self.core.sees_target().unsqueeze(-1),
            "steps": self.core.state.steps.unsqueeze(-1),
            "return": self.core.state.total.unsqueeze(-1),
        }
        info = TensorDict(info, batch_size=self.batch_size, device=self.device)
        return TensorDict(
            {**seen, "info": info, **values}, batch_size=self.batch_size, device=self.device
        )
