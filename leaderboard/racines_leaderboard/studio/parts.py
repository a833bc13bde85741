"""What the tabs load once for everybody: phantoms, dataset, pose index, grader, generators.

All of it is only read. Keys hold the time of the files, so that a new training is seen.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.shared import Shared

LARGEST = 256 * 2**20
"""Bytes of a generator's weights, at most: what remembers every frame does not fit many times."""
_phantoms: Shared[Any] = Shared(3)
_stores: Shared[Any] = Shared(2)
_indices: Shared[Any] = Shared(2)
_graders: Shared[Any] = Shared(2)
_generators: Shared[Any] = Shared(12)


@dataclass(frozen=True)
class Trained:
    """A trained generator on disk."""

    label: str
    """What the page calls it: its folder's name, and whether it is a run."""
    name: str
    """Registered name of its class."""
    folder: Path


def load_phantom(place: Place, anatomy: str | None = None) -> Any:
    """Return the phantom of the dataset, or the default one of a named anatomy."""
    from racines_data.phantom import PhantomConfig, shared_phantom
    from racines_envs.worlds.replay import source_phantom

    store = load_store(place) if anatomy is None else None
    config = source_phantom(store) if store is not None else None
    config = config or (PhantomConfig() if anatomy is None else PhantomConfig(anatomy=anatomy))
    key = config, place.device
    return _phantoms.get(key, lambda: shared_phantom(config, place.device))


def load_store(place: Place) -> Any:
    """Return the dataset's store; None where there is no dataset.

    Raises:
        RacinesError: it is damaged.
    """
    from racines_data.store.frames import open_store

    if place.data is None or not (place.data / "manifest.json").is_file():
        return None
    root = place.data
    return _stores.get(_stamp(root / "manifest.json"), lambda: open_store(root))


def load_index(place: Place) -> Any:
    """Return what finds the nearest frame of the dataset; None without a dataset or poses."""
    import torch

    from racines_envs.worlds.replay import PoseIndex

    store = load_store(place)
    if store is None or not bool(torch.isfinite(store.parameters[:, 6:]).all()):
        return None
    return _indices.get(store.digest, lambda: PoseIndex(store.parameters))


def load_grader(place: Place, labels: Sequence[str]) -> Any:
    """Return the grader of the runs or else the published one; None if none knows the labels."""
    from racines_models.judges.grader.model import WEIGHTS, Grader

    for folder in (place.runs / "grader", place.weights / "grader"):
        if not (folder / WEIGHTS).is_file():
            continue
        key = _stamp(folder / WEIGHTS), place.device
        grader = _graders.get(key, lambda where=folder: Grader.load(where, place.device))
        if grader.labels == tuple(labels):
            return grader
    return None


def trained_generators(place: Place) -> dict[str, Trained]:
    """Return the generators with weights by label: the published ones first, then the runs."""
    from racines_models.registry import generator_names

    trained: dict[str, Trained] = {}
    names = set(generator_names())
    for parent, suffix in ((place.weights, ""), (place.runs, " (run)")):
        for config in sorted(parent.glob("*/config.json")):
            name, folder = _generator_in(config), config.parent
            if name in names and _small(folder / "model.safetensors"):
                label = f"{folder.name}{suffix}"
                trained[label] = Trained(label, name, folder)
    return trained


def load_trained(trained: Trained, device: str) -> Any:
    """Return a trained generator, ready to draw.

    Raises:
        RacinesError: its files are damaged.
    """
    from racines_models.registry import load_generator

    key = _stamp(trained.folder / "model.safetensors"), device
    return _generators.get(key, lambda: load_generator(trained.name, trained.folder, device))


def read_config(path: Path) -> dict[str, Any]:
    """Return a run's config.json; empty where it is damaged."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _generator_in(config: Path) -> str:
    content = read_config(config)
    known = str(content.get("schema", "")).startswith("racines.generator/")
    return str(content.get("name", "")) if known else ""


def _small(weights: Path) -> bool:
    return weights.is_file() and weights.stat().st_size <= LARGEST


def _stamp(path: Path) -> tuple[str, int]:
    return str(path.resolve()), path.stat().st_mtime_ns
