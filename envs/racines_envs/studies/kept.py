"""What a long study keeps of itself on the way, so that one that was killed goes on."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import write_json

PARTS = "racines.ejection-parts/1"


def read_kept(path: Path, study: str, force: bool = False) -> dict[str, Any]:
    """Return what a JSON file holds of a study; nothing where there is none.

    Args:
        path: The file.
        study: A digest of all that decides the study's figures; the file has it as `study`.
        force: What the file holds is to be replaced, and counts as nothing.

    Raises:
        RacinesError: without `force`, a file of another study, or a damaged one.
    """
    if force or not path.is_file():
        return {}
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}; remove it") from error
    if isinstance(kept, dict) and kept.get("study") == study:
        return kept
    raise RacinesError(f"{path}: holds another study: give another --out, or --force")


@dataclass
class Kept:
    """The parts of a study that are done: rows of numbers by name, in a file where there is one."""

    path: Path | None
    study: str
    parts: dict[str, dict[str, list[float | None]]]
    spent: float
    """Seconds that earlier runs of the study took."""
    began: float

    @classmethod
    def open(cls, path: Path | None, study: str, force: bool) -> "Kept":
        """Take up what a file holds of a study; raises as `read_kept`."""
        held = {} if path is None else read_kept(path, study, force)
        began = time.perf_counter()
        return cls(path, study, held.get("parts", {}), held.get("seconds", 0.0), began)

    def part(self, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the (N,) columns of a part, made and kept if it is not there."""
        if name not in self.parts:
            made = make()
            self.parts[name] = {
                key: [float(value) if np.isfinite(value) else None for value in column]
                for key, column in made.items()
            }
            if self.path is not None:
                seconds = self.spent + time.perf_counter() - self.began
                content = {"schema": PARTS, "study": self.study, "parts": self.parts}
                write_json(self.path, content | {"seconds": seconds})
        return {key: np.array(row, np.float64) for key, row in self.parts[name].items()}
