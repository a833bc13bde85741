"""The curves' files: byte by byte what DVCLive 3.49 wrote of the same rows, also when resumed."""

from pathlib import Path

import numpy as np
import pytest

from racines_models.training.curves import Curves

ROWS: list[tuple[int, dict]] = [
    (12, {"loss": 1.5, "train/return": np.float32(0.1)}),
    (20, {"loss": float("nan"), "validation/steps": np.float64(3.25)}),
    (40, {"train/return": 1e-9, "n": 3, "loss": float("inf")}),
]
WRITTEN = {
    "metrics.json": '{\n    "loss": "inf",\n    "train": {\n        "return": 1e-09\n    },\n'
    '    "step": 40,\n    "validation": {\n        "steps": 3.25\n    },\n    "n": 3\n}\n',
    "plots/metrics/loss.tsv": "step\tloss\n12\t1.5\n20\tnan\n40\tinf\n",
    "plots/metrics/n.tsv": "step\tn\n40\t3\n",
    "plots/metrics/train/return.tsv": "step\treturn\n12\t0.1\n40\t1e-09\n",
    "plots/metrics/validation/steps.tsv": "step\tsteps\n20\t3.25\n",
}


def write(folder: Path, start: int, rows: list[tuple[int, dict]]) -> None:
    with Curves(folder, start) as curves:
        for step, values in rows:
            curves.row(step, values)


def written(folder: Path) -> dict[str, str]:
    root = folder / "dvclive"
    files = (path for path in root.rglob("*") if path.is_file())
    return {path.relative_to(root).as_posix(): path.read_bytes().decode() for path in files}


@pytest.mark.parametrize("killed", [False, True])
def test_the_bytes_are_dvclives_also_after_a_kill(tmp_path: Path, killed: bool):
    if not killed:
        write(tmp_path, 0, ROWS)
    else:
        write(tmp_path, 0, [*ROWS[:2], (30, {"loss": 0.0})])  # the last after its last checkpoint
        write(tmp_path, 20, ROWS[2:])
    assert written(tmp_path) == WRITTEN


def test_a_row_torn_by_the_kill_is_dropped_and_torn_values_are_forgotten(tmp_path: Path):
    write(tmp_path, 0, ROWS[:2])
    table = tmp_path / "dvclive/plots/metrics/loss.tsv"
    table.write_text(table.read_text() + "4")
    (tmp_path / "dvclive/metrics.json").write_text('{"loss": 1.')
    write(tmp_path, 20, ROWS[2:])
    assert written(tmp_path)["plots/metrics/loss.tsv"] == WRITTEN["plots/metrics/loss.tsv"]
    assert '"step": 40' in written(tmp_path)["metrics.json"]


def test_a_run_begun_anew_has_nothing_of_the_former(tmp_path: Path):
    write(tmp_path, 0, ROWS)
    write(tmp_path, 0, [])
    assert written(tmp_path) == {"metrics.json": "{}\n"}
