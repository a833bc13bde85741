"""Loss curves (DVCLive), sample grids and a progress bar: the trainer's only voice."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from dvclive.live import Live
from rich.progress import TextColumn
from torch import Tensor

from racines_data.progress import progress_bar

CURVES = "dvclive"


class TrainingLog:
    """Collects scalars between two rows of the curves, without waiting for the device.

    Of several processes one `writes`; the others collect, so that all hold the same state.
    """

    def __init__(
        self, folder: Path, name: str, start: int, stop: int, visible: bool, writes: bool = True
    ):
        self._live: Live | None = None
        if writes:
            curves = folder / CURVES
            _forget_after(curves, start)
            # Only files: no experiment is saved, no dvc.yaml written.
            self._live = Live(str(curves), resume=start > 0, save_dvc_exp=False, dvcyaml=None)
        self._sums: dict[str, Tensor] = {}
        self._steps = 0
        self.last: dict[str, float] = {}
        losses = TextColumn("{task.fields[losses]}")
        self._progress = progress_bar(visible and writes, "images", losses)
        self._task = self._progress.add_task(name, total=stop, completed=start, losses="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()
        if self._live:
            self._live.end()

    def add(self, scalars: Mapping[str, Tensor]) -> None:
        """Add one step's scalars to the row under way."""
        self._steps += 1
        for name, value in scalars.items():
            value = value.detach().float()
            self._sums[name] = self._sums[name] + value if name in self._sums else value

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
        if self._live is None or not values:
            return
        self._live.step = seen
        for name, value in values.items():
            self._live.log_metric(name, value)
        self._live.sync()

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs."""
        return {"sums": self._sums, "steps": self._steps, "last": self.last}

    def restore(self, state: dict[str, Any], device: Any) -> None:
        """Continue the row under way."""
        self._sums = {name: total.to(device) for name, total in state["sums"].items()}
        self._steps, self.last = state["steps"], state["last"]


def _forget_after(curves: Path, seen: int) -> None:
    """Drop rows that a killed run wrote after its last checkpoint, so that none appears twice."""
    for path in curves.glob("plots/metrics/**/*.tsv"):
        header, *rows = path.read_text().splitlines() or [""]
        kept = [row for row in rows if (row.split("\t")[0] or "x").isdigit()]
        kept = [row for row in kept if int(row.split("\t")[0]) <= seen]
        path.write_text("\n".join([header, *kept]) + "\n")
