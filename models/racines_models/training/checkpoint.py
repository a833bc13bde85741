"""One checkpoint file a run: written whole or not at all, and refused by another run."""

import os
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError

FOLDER = "checkpoint"
MISSING = "there is none"


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
        torch.save({"identity": self._identity, "state": state}, partial)
        os.replace(partial, self._path)

    def read(self, resume: bool | None) -> dict[str, Any] | None:
        """Return the state to continue from, or None to start anew; why is said on stderr.

        Args:
            resume: as `Run.resume`.

        Raises:
            RacinesError: `resume` is True and there is no checkpoint of this very run.
        """
        if resume is False:
            return None
        problem = MISSING
        if self._path.is_file():
            try:
                # weights_only: tensors and plain values, never pickled code.
                content = torch.load(self._path, map_location="cpu", weights_only=True)
                problem = self._difference(content["identity"])
                if not problem:
                    return content["state"]
            except (RuntimeError, EOFError, KeyError, pickle.UnpicklingError) as error:
                problem = f"it cannot be read ({error})"
        if resume:
            raise RacinesError(f"{self._path}: cannot resume: {problem}; use --fresh")
        if problem != MISSING:
            print(f"racines: {self._path}: {problem}: training starts anew", file=sys.stderr)
        return None

    def _difference(self, found: dict[str, Any]) -> str:
        keys = [key for key in self._identity if found.get(key) != self._identity[key]]
        return f"it was made with another {', '.join(keys)}" if keys else ""


def discard_checkpoint(folder: Path) -> None:
    """Remove the checkpoint of a finished run."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
