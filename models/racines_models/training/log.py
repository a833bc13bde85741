"""The trainer's voice, loss curves and a progress bar, and the guard that stops it."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
from rich.progress import TextColumn
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.progress import progress_bar
from racines_models.training.curves import Curves


class TrainingLog:
    """Collects scalars between two rows of the curves, without waiting for the device.

    Of several processes one `writes`; the others collect, so that all hold the same state.
    """

    def __init__(
        self, folder: Path, name: str, start: int, stop: int, visible: bool, writes: bool = True
    ):
        self._curves = Curves(folder, start) if writes else None
        self._sums: dict[str, Tensor] = {}
        self._steps = 0
        self.last: dict[str, float] = {}
        losses = TextColumn("{task.fields[losses]}", markup=False)
        self._progress = progress_bar(visible and writes, "images", losses)
        self._task = self._progress.add_task(name, total=stop, completed=start, losses="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._progress.stop()
        if self._curves:
            self._curves.__exit__(*error)

    def add(self, scalars: Mapping[str, Tensor]) -> None:
        """Add one step's scalars to the row under way."""
        self._steps += 1
        _add(self._sums, scalars)

    def row(self, seen: int) -> None:
        """Write the means since the last row."""
        if not self._steps:
            return
        self.last = {name: float(total) / self._steps for name, total in self._sums.items()}
        self._sums, self._steps = {}, 0
        self.metrics(seen, self.last)
        losses = "  ".join(f"{name} {value:.4f}" for name, value in self.last.items())
        self._progress.update(self._task, completed=seen, losses=losses)

    def metrics(self, seen: int, values: Mapping[str, float]) -> None:
        """Write values at an image count."""
        if self._curves and values:
            self._curves.row(seen, values)

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs."""
        return {"sums": self._sums, "steps": self._steps, "last": self.last}

    def restore(self, state: dict[str, Any], device: Any) -> None:
        """Continue the row under way."""
        self._sums = {name: total.to(device) for name, total in state["sums"].items()}
        self._steps, self.last = state["steps"], state["last"]


class Guard:
    """Stops a training whose loss is no longer a number, before it overwrites its checkpoint.

    It looks after every step on a CPU, and with the curves elsewhere: reading a loss makes an
    accelerator wait, so there they are summed. A sum that holds one NaN or infinity is one.
    """

    def __init__(self, name: str, device: torch.device, start: int = 0):
        self._name = name
        self.every_step = device.type == "cpu"
        self._sums: dict[str, Tensor] = {}
        self._checked_at = start

    def add(self, losses: Mapping[str, Tensor]) -> None:
        """Add one step's losses by the name of their optimizer."""
        _add(self._sums, losses)

    def check(self, seen: int) -> None:
        """Refuse to go on if one of the losses since the last check is NaN or infinite."""
        sums = {name: float(total) for name, total in self._sums.items()}
        broken = [(name, value) for name, value in sums.items() if not math.isfinite(value)]
        if broken:
            named = " and ".join(f"loss {name!r} is {value}" for name, value in broken)
            raise RacinesError(
                f"{self._name}: {named} between images {self._checked_at:,} and "
                f"{seen:,}; the last checkpoint is kept. Lower the learning rate, set "
                "training.gradient_clip (1, say) or training.precision: fp32"
            )
        self._sums, self._checked_at = {}, seen


def _add(sums: dict[str, Tensor], scalars: Mapping[str, Tensor]) -> None:
    for name, value in scalars.items():
        value = value.detach().float()
        sums[name] = sums[name] + value if name in sums else value
