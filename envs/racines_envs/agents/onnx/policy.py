"""A policy in an ONNX file, run by onnxruntime: no code of the file's maker in Python."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.onnx.format import IMAGE, OUTPUT, PARAMS, read_policy
from racines_envs.agents.policy import choose
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_models.exchange.onnx.file import open_session
from racines_models.exchange.onnx.generator import Opener
from racines_models.provenance import sha256_bytes

BATCH = 8
"""Rows a call where the graph leaves the batch free."""
FILE = "policy.onnx"
"""The file that is looked for in a folder."""


@dataclass(frozen=True)
class OnnxPolicyConfig:
    """Nothing to set: the file says it all."""


class OnnxPolicyAgent:
    """Acts by the graph of one file (see `onnx_policy_format` for its interface).

    Calls have one size, the last one padded, so that a row's action ignores its batch; onnxruntime
    runs on one thread in its deterministic mode.

    Raises:
        RacinesError: the file is refused, or onnxruntime cannot load it.
    """

    name: ClassVar[str] = "onnx"
    Config: ClassVar[type] = OnnxPolicyConfig
    observation: str = "image"

    def __init__(
        self,
        path: Path | str,
        device: torch.device | str = "cpu",
        opener: Opener = open_session,
    ) -> None:
        """Open a file; `opener` makes of its bytes, its name and the device what runs it."""
        self.path = Path(path)
        content, self.interface = read_policy(self.path)
        self.sha256 = sha256_bytes(content)
        """Hash of the file."""
        self.observation = self.interface.observation
        if self.interface.view is not None:
            self.view = self.interface.view
        self._session = opener(content, str(self.path), str(device))
        self._batch = self.interface.batch or BATCH

    def attach(self, core: ScanCore) -> None:
        """Keep nothing of the environment."""

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the action of each row: of the greatest logit, or drawn at the temperature.

        Raises:
            RacinesError: an observation that it lacks, or logits of wrong shape or not finite.
        """
        logits = self.logits(observation).to(seeds.device)
        return choose(logits, seeds, self.interface.temperature)

    def logits(self, observation: dict[str, Tensor]) -> Tensor:
        """Return the (N, 13) float32 scores of the actions, on the CPU."""
        keys = [key for key in (IMAGE, PARAMS) if self.observation in (key, "multimodal")]
        missing = [key for key in keys if key not in observation]
        if missing:
            raise RacinesError(
                f"{self.path}: needs {', '.join(missing)}: make the environment with "
                f"observation={self.observation!r}"
            )
        seen = {key: observation[key].cpu() for key in keys}
        count = len(seen[keys[0]])
        parts = [self._run(seen, start, count) for start in range(0, count, self._batch)]
        return torch.cat([torch.empty(0, len(ACTIONS)), *parts])

    def _run(self, seen: dict[str, Tensor], start: int, count: int) -> Tensor:
        # The last row again, not zeros: the graph need not bear an image that no probe makes.
        rows = torch.arange(start, start + self._batch).clamp_max(count - 1)
        try:
            (logits,) = self._session.run(
                [OUTPUT], {key: value[rows].numpy() for key, value in seen.items()}
            )
        except RacinesError:
            raise
        except Exception as error:
            raise RacinesError(f"{self.path}: onnxruntime failed: {error}") from error
        if logits.shape != (self._batch, len(ACTIONS)) or not np.isfinite(logits).all():
            raise RacinesError(
                f"{self.path}: {OUTPUT} came with shape {logits.shape} for {self._batch} rows, or "
                f"not finite: give finite (B, {len(ACTIONS)})"
            )
        return torch.from_numpy(logits)[: count - start]

    @classmethod
    def train(cls, config: Any, run_dir: Path, **where: Any) -> Self:
        """Refuse: a file is made by `racines export agent`, or by another program."""
        raise RacinesError(
            "agent 'onnx' has nothing to learn: train another and export it: "
            "racines export agent RUN --out policy.onnx"
        )

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Open a file, or `policy.onnx` in a folder."""
        path = Path(run_dir)
        return cls(path / FILE if path.is_dir() else path, device)
