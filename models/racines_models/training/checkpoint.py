"""What a run leaves on its way, its checkpoint, and where the runs of several seeds stand.

Of a method that is trained with several seeds, each is a run of its own: the first stands in the
run's folder, as if it were the only one; seed n in its subfolder `seed-n`.
"""

import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.terminal import say

FOLDER = "checkpoint"
MISSING = "there is none"
PREFIX = "seed-"


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


def repeat_folders(folder: Path) -> list[Path]:
    """Return the folders of the further seeds of a run, by seed."""
    found = {path.name.removeprefix(PREFIX): path for path in folder.glob(f"{PREFIX}*")}
    return [found[seed] for seed in sorted(filter(str.isdigit, found), key=int)]
