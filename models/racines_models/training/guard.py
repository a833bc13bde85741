"""Stops a training whose loss is no longer a number, before it overwrites its checkpoint."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from racines_data.errors import RacinesError


class Guard:
    """Looks at the losses after every step on a CPU, and with the curves elsewhere.

    Reading a loss makes an accelerator wait, so there they are summed: a sum that holds one NaN
    or infinity is one.
    """

    def __init__(self, name: str, device: torch.device, start: int = 0):
        self._name = name
        self.every_step = device.type == "cpu"
        self._sums: dict[str, Tensor] = {}
        self._checked_at = start

    def add(self, losses: Mapping[str, Tensor]) -> None:
        """Add one step's losses by the name of their optimizer."""
        for name, loss in losses.items():
            loss = loss.detach().float()
            self._sums[name] = self._sums[name] + loss if name in self._sums else loss

    def check(self, seen: int) -> None:
        """Look at the losses since the last check.

        Raises:
            RacinesError: one is NaN or infinite.
        """
        sums = {name: float(total) for name, total in self._sums.items()}
        broken = {name: value for name, value in sums.items() if not math.isfinite(value)}
        if broken:
            named = " and ".join(f"loss {name!r} is {value}" for name, value in broken.items())
            raise RacinesError(
                f"{self._name}: {named} between images {self._checked_at:,} and "
                f"{seen:,}; the last checkpoint is kept. Lower the learning rate, set "
                "training.gradient_clip (1, say) or training.precision: fp32"
            )
        self._sums, self._checked_at = {}, seen
