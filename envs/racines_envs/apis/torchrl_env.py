"""The tasks as one natively batched TorchRL environment on the core."""

from typing import Any

import torch

from racines_data.extras import absent
from racines_data.imaging import IMAGE_SIZE
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE
from racines_envs.task.motion import Velocity
from racines_envs.task.tasks import Task
from racines_envs.worlds.making import check_settings, make_core
from racines_models.devices import resolve_device

try:
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
    from torchrl.envs import EnvBase
except ModuleNotFoundError as error:
    raise absent(str(error.name), "ScanEnv") from error


class ScanEnv(EnvBase):
    """N probes on one phantom, or on the patients of a ward; batch size (N,).

    Keys: `image` (N, 1, 128, 128) uint8, channels first (with an encoder, its `features` instead),
    and/or `params` (N, 9) float32, `goal` (N, V) where it is drawn for each episode, and
    `action_mask` (N, 13) bool where recordings mask steps; `action` (N,) int64, or (N, 6) float32
    twists with `action="velocity"`; `reward`, `done`, `terminated`, `truncated` (N, 1); and under
    `info`, for curves and not for policies, `success` by the oracle, `steps` and `return` so far.
    """

    def __init__(
        self, view: str | Task, num_envs: int = 1, *, seed: int = 0,
        device: torch.device | str = "cpu", **settings: Any,
    ) -> None:  # fmt: skip
        """Build N rows of a task; settings as for `racines_envs.worlds.making.make_core`."""
        device = resolve_device(device)
        super().__init__(device=torch.device(device), batch_size=torch.Size([num_envs]))
        self.core = make_core(view, num_envs, device=device, **check_settings(settings))
        self._make_specs(num_envs)
        self._start_seed: int | None = None
        self.set_seed(seed)

    def _make_specs(self, n: int) -> None:
        rows, column = torch.Size([n]), torch.Size([n, 1])
        core, float32 = self.core, torch.float32
        seen: dict[str, Any] = {}
        if core.encoder is not None:
            seen["features"] = Unbounded(torch.Size([n, core.encoder.size]), dtype=float32)
        elif core.observation != "params":
            image = torch.Size([n, 1, IMAGE_SIZE, IMAGE_SIZE])
            seen["image"] = Bounded(0, 255, image, dtype=torch.uint8)
        if core.observation != "image":
            seen["params"] = Bounded(-1.0, 1.0, torch.Size([n, PARAMS_SIZE]), dtype=float32)
            if core.robot.joints:
                seen["joints"] = Unbounded(torch.Size([n, core.robot.joints]), dtype=float32)
        if core.task.any_view:
            goals = torch.Size([n, len(core.phantom.views)])
            seen["goal"] = Bounded(0.0, 1.0, goals, dtype=float32)
        if core.masks:
            steps = len(ACTIONS)
            seen["action_mask"] = Binary(steps, torch.Size([n, steps]), dtype=torch.bool)
        info = {
            "success": Binary(1, column, dtype=torch.bool),
            "steps": Unbounded(column, dtype=torch.int64),
            "return": Unbounded(column, dtype=float32),
        }
        seen["info"] = Composite(info, shape=rows)
        self.observation_spec = Composite(seen, shape=rows)
        self.action_spec = Categorical(len(ACTIONS), rows, dtype=torch.int64)
        if isinstance(core.motion, Velocity):
            limits = core.motion.limits.expand(n, 6)
            self.action_spec = Bounded(-limits, limits, torch.Size([n, 6]), dtype=float32)
        self.reward_spec = Unbounded(column)
        flag = Categorical(2, column, dtype=torch.bool)
        flags = {key: flag.clone() for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(flags, shape=rows)
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
        done = self.core.state.done
        return self._pack({"done": done, "terminated": done, "truncated": done})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        _, reward, terminated, truncated = self.core.step(tensordict["action"])
        done = self.core.state.done
        flags = {"done": done, "terminated": terminated, "truncated": truncated}
        return self._pack({"reward": reward} | flags)

    def _pack(self, values: dict[str, torch.Tensor]) -> TensorDictBase:
        """Join observations and info with (N,) entries, all as columns."""
        core, state, seen = self.core, self.core.state, self.core.observe()
        if core.encoder is not None:
            del seen["image"]
        elif "image" in seen:
            seen["image"] = seen["image"].unsqueeze(1)
        told = {"success": core.succeeds(), "steps": state.steps, "return": state.total}
        columns, info = (
            {name: value.unsqueeze(-1) for name, value in rows.items()} for rows in (values, told)
        )
        place: Any = {"batch_size": self.batch_size, "device": self.device}
        return TensorDict({**seen, "info": TensorDict(info, **place), **columns}, **place)
