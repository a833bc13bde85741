"""One method trained with several seeds: each seed a run of its own.

The first stands in the run's folder, as if it were the only one; seed n in its subfolder `seed-n`.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_models.protocol import Run
from racines_models.training.processes import is_main_process

PREFIX = "seed-"
DONE = "repeats.json"
"""Written while the seeds are under way: metrics of those that are done, so that a killed run does
not begin again with the first."""


def train_seeds(fit: Callable[[Run], dict[str, Any]], run: Run, repeats: int) -> dict[str, Any]:
    """Train seeds `run.seed`, `run.seed + 1`, …; return the first's metrics, all under `seeds`.

    Args:
        fit: Trains one run.
        run: The first; the others stand in `seed-<n>` of its folder.
        repeats: Number of seeds.
    """
    folders = [run.folder, *(run.folder / f"{PREFIX}{run.seed + k}" for k in range(1, repeats))]
    for folder in repeat_folders(run.folder):
        if folder not in folders and is_main_process():
            shutil.rmtree(folder)  # of a former run with more seeds
    if repeats == 1:
        return fit(run)
    done, resume = _done(run), run.resume
    for number, folder in enumerate(folders):
        seed = run.seed + number
        if str(seed) in done:
            continue
        one = dataclasses.replace(run, folder=folder, seed=seed, resume=resume)
        done[str(seed)] = fit(one)
        resume = None if resume else resume  # only the seed that was cut short has a checkpoint
        if is_main_process():
            write_json(run.folder / DONE, {"first": run.seed, "done": done})
    metrics = done[str(run.seed)] | {"seeds": done}
    if is_main_process():
        write_json(run.folder / "metrics.json", metrics)
        (run.folder / DONE).unlink()
    return metrics


def _done(run: Run) -> dict[str, Any]:
    notes = run.folder / DONE
    if run.resume is False or not notes.is_file():
        return {}
    kept = json.loads(notes.read_text())
    return kept["done"] if kept["first"] == run.seed else {}


def repeat_folders(folder: Path) -> list[Path]:
    """Return the folders of the further seeds of a run, by seed."""
    found = [path for path in folder.glob(f"{PREFIX}*") if path.name[len(PREFIX) :].isdigit()]
    return sorted(found, key=lambda path: int(path.name[len(PREFIX) :]))
