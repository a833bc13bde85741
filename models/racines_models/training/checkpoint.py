"""What a run leaves on its way: its checkpoint, and of several seeds those that are done.

Of a method that is trained with several seeds, each is a run of its own: the first stands in the
run's folder, as if it were the only one; seed n in its subfolder `seed-n`.
"""

import dataclasses
import json
import os
import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from racines_data.engines import Engine
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.terminal import say
from racines_models.protocol import Run
from racines_models.training.processes import is_main_process

FOLDER = "checkpoint"
MISSING = "there is none"
PREFIX = "seed-"
DONE = "repeats.json"
"""Written while the seeds are under way: metrics of those that are done, so that a killed run does
not begin again with the first."""


class Checkpoint:
    """Reads and writes `checkpoint/last.pt` in the folder of one run.

    `identity` says what is being trained on what (generator, config, seed, data). Only a
    checkpoint with an equal identity is continued: anything else would end in weights that no
    undisturbed run reaches.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]):
        self._path = folder / FOLDER / "last.pt"
        self._identity = identity

    def write(self, state: dict[str, Any]) -> None:
        """Replace the checkpoint atomically."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        partial = self._path.with_suffix(".partial")
        try:
            torch.save({"identity": self._identity, "state": state}, partial)
        except RuntimeError as error:  # its writer says so where a disk is full
            partial.unlink(missing_ok=True)
            raise RacinesError(
                f"{self._path}: cannot be written ({error}): free some space, or name another "
                "place; the last checkpoint is kept"
            ) from error
        os.replace(partial, self._path)

    def read(self, resume: bool | None) -> dict[str, Any] | None:
        """Return the state to continue from, or None to start anew; why is said on stderr.

        Raises:
            RacinesError: `resume` (see `Run`) is True and there is no checkpoint of this very run.
        """
        if resume is False:
            return None
        problem = MISSING
        if self._path.is_file():
            try:
                # weights_only: tensors and plain values, never pickled code.
                content = torch.load(self._path, map_location="cpu", weights_only=True)
                found = content["identity"]
                keys = [key for key in self._identity if found.get(key) != self._identity[key]]
                if not keys:
                    return content["state"]
                problem = f"it was made with another {', '.join(keys)}"
            except (RuntimeError, EOFError, KeyError, pickle.UnpicklingError) as error:
                problem = f"it cannot be read ({error})"
        if resume:
            raise RacinesError(f"{self._path}: cannot resume: {problem}; use --fresh")
        if problem != MISSING:
            say(f"racines: {self._path}: {problem}: training starts anew", err=True)
        return None


def discard_checkpoint(folder: Path) -> None:
    """Remove the checkpoint of a finished run."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


def train_seeds(
    fit: Callable[[Run], dict[str, Any]], run: Run, repeats: int, engine: Engine | None = None
) -> dict[str, Any]:
    """Train seeds `run.seed`, `run.seed + 1`, …; return the first's metrics, all under `seeds`.

    `fit` trains one run. `run` is the first; the others stand in `seed-<n>` of its folder. With an
    `engine` that is started each seed is a task, whose checkpoint is where it goes on if its worker
    dies; all workers have to see the folder.

    Raises:
        RacinesError: the folder holds trainings of other seeds, and `run.resume` is not False; or
            workers wrote into another.
    """
    folders = [run.folder, *(run.folder / f"{PREFIX}{run.seed + k}" for k in range(1, repeats))]
    others = [each for each in repeat_folders(run.folder) if each not in folders]
    if others and run.resume is not False:
        names = ", ".join(each.name for each in others)
        raise RacinesError(
            f"{run.folder}: holds trainings that this run would remove ({names}; repeats is "
            f"{repeats}): move them away, raise repeats, give another --out, or --fresh"
        )
    for folder in others:
        if is_main_process():
            shutil.rmtree(folder)
    if repeats == 1 and engine is None:
        return fit(run)
    done, notes = {}, run.folder / DONE
    if run.resume is not False and notes.is_file():
        kept = json.loads(notes.read_text())
        done = kept["done"] if kept["first"] == run.seed else {}
    waiting = [
        dataclasses.replace(run, folder=folder, seed=seed)
        for seed, folder in enumerate(folders, start=run.seed)
        if str(seed) not in done
    ]
    fitted = _one_by_one(fit, waiting) if engine is None else _at_once(engine, fit, waiting)
    for one, metrics in zip(waiting, fitted, strict=True):
        done[str(one.seed)] = metrics
        if is_main_process() and repeats > 1:
            write_json(notes, {"first": run.seed, "done": done})
    if repeats == 1:
        return done[str(run.seed)]
    metrics = done[str(run.seed)] | {"seeds": done}
    if is_main_process():
        write_json(run.folder / "metrics.json", metrics)
        notes.unlink()
    return metrics


def _one_by_one(
    fit: Callable[[Run], dict[str, Any]], runs: Sequence[Run]
) -> Iterator[dict[str, Any]]:
    for place, one in enumerate(runs):
        # Only the seed that was cut short has a checkpoint.
        later = place > 0 and one.resume is True
        yield fit(dataclasses.replace(one, resume=None) if later else one)


def _at_once(
    engine: Engine, fit: Callable[[Run], dict[str, Any]], runs: Sequence[Run]
) -> Iterator[dict[str, Any]]:
    # Any of them may have been cut short, or not begun.
    resume = False if runs and runs[0].resume is False else None
    tasks = [dataclasses.replace(one, resume=resume, progress=False) for one in runs]
    made = engine.map(_fit, fit, tasks, threads=None, remedy="to go on")
    for one, metrics in zip(runs, made, strict=True):
        if not one.folder.is_dir():
            raise RacinesError(
                f"{one.folder}: a worker trained seed {one.seed} and nothing is there: give --out "
                "a folder that all nodes of the cluster see"
            )
        yield metrics


def _fit(fit: Callable[[Run], dict[str, Any]], run: Run) -> dict[str, Any]:
    return fit(run)


def repeat_folders(folder: Path) -> list[Path]:
    """Return the folders of the further seeds of a run, by seed."""
    found = {path.name.removeprefix(PREFIX): path for path in folder.glob(f"{PREFIX}*")}
    return [found[seed] for seed in sorted(filter(str.isdigit, found), key=int)]
