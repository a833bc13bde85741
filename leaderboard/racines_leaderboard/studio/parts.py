"""What the tabs load once for everybody: phantoms, dataset, pose index, grader, generators.

All of it is only read. Keys hold the time of the files, so that a new training is seen. A damaged
file raises a `RacinesError` in whoever asks for what it holds.
"""

import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from racines_data.manifest import MANIFEST


@dataclass(frozen=True)
class Place:
    """Folders and settings of one Studio; a folder that is missing empties its tab alone."""

    data: Path | None = Path("data/racines")
    """The dataset."""
    results: Path = Path("leaderboard/results")
    """The boards."""
    submissions: Path = Path("leaderboard/submissions")
    weights: Path = Path("models/weights")
    """Published weights."""
    runs: Path = Path("models/runs")
    """Trained generators and graders."""
    agents: Path = Path("envs/runs")
    """Trained agents."""
    kits: Path | None = Path("study")
    """A folder of expert kits; ratings of `KIT` go to `KIT-ratings` beside it."""
    seed: int = 0
    device: str = "cpu"
    max_sessions: int = 200
    """Visitors whose state is kept; the one who was idle longest is forgotten first."""
    policies: Path = Path("envs/weights")
    """Published agents."""


Kept = TypeVar("Kept")
LARGEST = 256 * 2**20
"""Bytes of a generator's weights, at most: what remembers every frame does not fit many times."""


class Shared(Generic[Kept]):
    """The last few values by key; making one holds up only those who want the same."""

    def __init__(self, capacity: int) -> None:
        """Keep at most `capacity` values, one or more."""
        self._capacity = max(1, capacity)
        self._kept: OrderedDict[Hashable, Kept] = OrderedDict()
        self._gates: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: Hashable, make: Callable[[], Kept]) -> Kept:
        """Return the value of a key, made now if it is not kept; what `make` raises passes on."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            gate = self._gates.setdefault(key, threading.Lock())
        with gate:
            with self._lock:
                if key in self._kept:  # somebody made it while we waited
                    return self._kept[key]
            try:
                value = make()
                self.put(key, value)
            finally:
                with self._lock:
                    self._gates.pop(key, None)
        return value

    def put(self, key: Hashable, value: Kept) -> None:
        """Keep a value in place of the key's last one."""
        with self._lock:
            self._kept[key] = value
            self._kept.move_to_end(key)
            while len(self._kept) > self._capacity:
                self._kept.popitem(last=False)


_phantoms: Shared[Any] = Shared(3)
_stores: Shared[Any] = Shared(4)
_indices: Shared[Any] = Shared(2)
_graders: Shared[Any] = Shared(2)
_generators: Shared[Any] = Shared(12)


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
    """Return the dataset's store; None where there is no dataset."""
    root = place.data
    return shared_store(root) if root is not None and (root / MANIFEST).is_file() else None


def shared_store(root: Path, config: str = "frames") -> Any:
    """Return the store of a dataset's config, opened again once the dataset is built anew."""
    from racines_data.store.frames import open_store

    key = _stamp(root / MANIFEST), config
    return _stores.get(key, lambda: open_store(root, config))


def load_index(place: Place) -> Any:
    """Return what finds the nearest frame of the dataset; None without a dataset or poses."""
    from racines_envs.worlds.replay import PoseIndex

    store = load_store(place)
    if store is None or not store.parameters[:, 6:].isfinite().all():
        return None
    return _indices.get(store.digest, lambda: PoseIndex(store.parameters))


def load_grader(place: Place, labels: Sequence[str], tier: str = "") -> Any:
    """Return the grader of the runs or else the published one; None if none knows the labels.

    With a `tier` it is the published one of that folder.
    """
    from racines_models.judges.grader.model import WEIGHTS, Grader

    known = (place.runs / "grader", place.weights / "grader")
    for folder in (place.weights / tier / "grader",) if tier else known:
        if not (folder / WEIGHTS).is_file():
            continue
        key = _stamp(folder / WEIGHTS), place.device
        grader = _graders.get(key, lambda where=folder: Grader.load(where, place.device))
        if grader.labels == tuple(labels):
            return grader
    return None


def trained_runs(
    weights: str, *parents: tuple[Path, str]
) -> Iterator[tuple[str, dict[str, Any], Path]]:
    """Yield label, config.json and weights of each run in some folders that has both whole.

    A label is the name of the run's folder, and the suffix that goes with the folder of runs.
    """
    for parent, suffix in parents:
        for path in sorted(parent.glob("*/config.json")):
            try:
                config = json.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            found = path.with_name(weights)
            if isinstance(config, dict) and found.is_file():
                yield f"{path.parent.name}{suffix}", config, found


def trained_generators(place: Place) -> dict[str, tuple[str, Path]]:
    """Return registered name and weights of the trained generators, the published ones first."""
    from racines_models.registry import generator_names

    trained, registered = {}, generator_names()
    folders = (place.weights, ""), (place.runs, " (run)")
    for label, config, weights in trained_runs("model.safetensors", *folders):
        ours = str(config.get("schema", "")).startswith("racines.generator/")
        small = weights.stat().st_size <= LARGEST
        if ours and small and config.get("name") in registered:
            trained[label] = config["name"], weights
    return trained


def load_trained(name: str, weights: Path, device: str) -> Any:
    """Return a trained generator, ready to draw."""
    from racines_models.registry import load_generator

    key = _stamp(weights), device
    return _generators.get(key, lambda: load_generator(name, weights.parent, device))


def _stamp(path: Path) -> tuple[str, int]:
    return str(path.resolve()), path.stat().st_mtime_ns
