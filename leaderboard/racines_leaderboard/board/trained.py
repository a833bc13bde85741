"""What a run tells of its training: images, steps of the environment, and hours of the first one.

It is read where the weights that a record names lie: among the published ones, or else in the runs
of the current folder. Other weights of the same name tell nothing of it.
"""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.published.catalogue import CATALOGUE, read_catalogue
from racines_models.published.places import published

CONFIG = "config.json"
TOLD = (CONFIG, "metrics.json")
"""What says it: the one of published generators, the other of all others."""
RUNS = ("models/runs", "models/runs/patients", "models/runs/motion", "envs/runs")


def training_of(folder: Path) -> dict[str, float]:
    """Return `images`, `steps` and `hours` of the training in a folder, as far as it is told.

    Images are those that a network learned from; steps those that were taken in an environment.
    """
    found: dict[str, float] = {}
    for name in TOLD:
        told = read_told(folder / name)
        rounds = list(_rounds(told))
        budget = _part(_part(told, "config"), "training").get("images")
        seconds = told.get("seconds", _sum(rounds, "seconds"))
        figures = {
            # Of a generator that does not say what it saw, as many as it was set to see.
            "images": _sum(rounds, "images") or found.get("images", budget),
            "steps": told.get("frames"),
            "hours": None if seconds is None else seconds / 3600,
        }
        found |= {key: each for key, each in figures.items() if each is not None}
    return found


def trained_as(record: dict[str, Any]) -> dict[str, float]:
    """Return what is told of the first training of a record's weights, wherever they lie here."""
    weights = record["scores"].get("weights") or {}
    files = weights.get("files", weights)
    first = {name: sha256 for name, sha256 in files.items() if "/" not in name}
    manifest = published(CATALOGUE)
    changed = manifest.stat().st_mtime_ns if manifest.is_file() else 0
    among = _published(manifest, changed)
    folder = next((among[sha256] for sha256 in first.values() if sha256 in among), None)
    if folder is None and first:
        names = (record["name"], record["name"].rpartition("-")[0])  # a run may serve all views
        runs = (Path(root, name) for root in RUNS for name in names if name)
        folder = next((each for each in runs if _has(each, first)), None)
    return {} if folder is None else training_of(folder)


def read_told(path: Path) -> dict[str, Any]:
    """Return what a JSON file says; nothing where there is none that can be read."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}


@cache
def _published(manifest: Path, changed: int) -> dict[str, Path]:
    """Return by sha256 where published weights of first trainings lie; copies by the originals'.

    A manifest that has `changed` since is read again.
    """
    try:
        catalogue = read_catalogue()
    except RacinesError:
        return {}
    found = {}
    for each in catalogue.sets.values():
        folder = catalogue.root / each.folder
        copies = _part(_part(read_told(folder / CONFIG), "weights_files"), "files")
        for name, file in each.files.items():
            if name.endswith(".safetensors") and "/" not in name:
                found[file["sha256"]] = found[_part(copies, name).get("made_of")] = folder
    found.pop(None, None)
    return found


def _has(folder: Path, files: dict[str, str]) -> bool:
    paths = {folder / name: sha256 for name, sha256 in files.items()}
    return all(path.is_file() and sha256_file(path) == sha256 for path, sha256 in paths.items())


def _part(told: dict[str, Any], key: str) -> dict[str, Any]:
    part = told.get(key)
    return part if isinstance(part, dict) else {}


def _rounds(told: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Give what was told of each round of a training: the last first, of most the only one."""
    last = _part(told, "training")
    told = last if "training" in last else told
    yield _part(told, "training")
    yield from (_part(each, "training") for each in told.get("rounds", ()))


def _sum(rounds: list[dict[str, Any]], key: str) -> float | None:
    told = [each[key] for each in rounds if isinstance(each.get(key), int | float)]
    return sum(told) if told else None
