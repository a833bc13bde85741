"""Curves of a training as files: a table for each figure, and the latest values.

The layout is DVCLive's, so that `dvc plots show` and whatever else reads that draws them:

    dvclive/plots/metrics/train/return.tsv    step <tab> return, one row a step
    dvclive/metrics.json                      {"train": {"return": 1.5}, "step": 4096}

They are written here, and not by that package, because it brings all of DVC along.
"""

import csv
import json
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from racines_data.files import naming, write_atomic

CURVES = "dvclive"
"""Folder of the curves in that of a run."""
_TABLES = Path("plots") / "metrics"


class Curves:
    """The curves of one run; a context that leaves the latest values written."""

    def __init__(self, run_dir: Path, start: int = 0) -> None:
        """Begin anew, or go on after step `start` of a run that was killed, and was once further.

        Rows later than `start` are dropped, so that none appears twice.
        """
        self.folder = run_dir / CURVES
        self._latest: dict[str, Any] = {}
        self.folder.mkdir(parents=True, exist_ok=True)
        if start:
            self._latest = _read_latest(self.folder / "metrics.json")
            _forget_after(self.folder / _TABLES, start)
        else:
            shutil.rmtree(self.folder / _TABLES, ignore_errors=True)
            (self.folder / "metrics.json").unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._write_latest()

    def row(self, step: int, values: Mapping[str, float]) -> None:
        """Write values at a step; a name such as `train/return` is a path, NaN the word `nan`."""
        for name, value in values.items():
            told = value if math.isfinite(value) else str(value)
            self._append(self.folder / _TABLES / f"{name}.tsv", step, told)
            *folders, last = name.split("/")
            place = self._latest
            for each in folders:
                place = place.setdefault(each, {})
            place[last] = told
        self._latest["step"] = step
        self._write_latest()

    def _append(self, path: Path, step: int, value: float | str) -> None:
        with naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            new = not path.exists()
            with path.open("a", encoding="utf-8", newline="") as file:
                table = csv.writer(file, delimiter="\t", lineterminator="\n")
                if new:
                    table.writerow(["step", path.stem])
                table.writerow([step, value])

    def _write_latest(self) -> None:
        # Scalars of NumPy are written as the numbers that they are.
        content = json.dumps(self._latest, indent=4, default=lambda value: value.item())
        write_atomic(self.folder / "metrics.json", content + "\n")


def _read_latest(path: Path) -> dict[str, Any]:
    """Return the latest values; none where a kill met their writing."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _forget_after(tables: Path, step: int) -> None:
    """Drop rows later than a step, and a last one that a kill tore."""
    for path in tables.glob("**/*.tsv"):
        header, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True) or ["step\n"]
        whole = [row for row in rows if row.endswith("\n")]
        kept = [row for row in whole if int(row.partition("\t")[0]) <= step]
        write_atomic(path, "".join([header, *kept]))
