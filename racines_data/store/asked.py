"""What is asked of generators on patients: scouts, and the frames at the poses to be drawn."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import torch
from safetensors.torch import save_file
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_once
from racines_data.geometry import parameters_to_pose
from racines_data.patients.labels import LABELS as MASK_LABELS
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.pool import Pool
from racines_data.patients.scouts import (
    FRAMES,
    POSES,
    SCOUTS_VERSION,
    STRATA,
    Scouted,
    scout,
    strata_of,
)
from racines_data.patients.splits import check_split, seeds_of
from racines_data.store.hearts import columns
from racines_data.store.scouts import MadeStore


class AskedStore(MadeStore):
    """The frames at the poses that are asked for of P patients, each a trajectory of 32 frames.

    Who draws them is shown the scouts alone.
    """

    scouts: Tensor
    """(P, 64, 128, 128) uint8."""
    scout_parameters: Tensor
    """(P, 64, 12) float32."""
    again: Tensor
    """(P, 32, 128, 128) uint8, the same poses seen a second time."""
    strata: Tensor
    """(P · 32,) int64, which stratum of distance to the scout each frame is in."""

    def __init__(
        self, split: str, patients: int | tuple[int, ...], seed: int, cache: Path | None = None,
        progress: Callable[[int], None] | None = None, engine: Engine | None = None,
    ) -> None:  # fmt: skip
        """Scan patients of a split, or read what a former run left in the folder `cache`.

        An `engine`, started, scans a patient a task; None: this process.

        Raises:
            RacinesError: an unknown split, a patient of another, or more than it has.
        """
        self.config, self.root = "asked", Path(cache or ".")
        seeds = _chosen(split, patients)
        digest = asked_digest(split, patients, seed)
        parts = []
        for part in _scanned(seeds, seed, cache, engine or LocalEngine()):
            parts.append(part)
            if progress is not None:
                progress(1)
        held = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        self._hold(held["truth"].flatten(0, 1), held["asked"].flatten(0, 1), list(seeds), POSES)
        self._splits = {name: [0, 0] for name in ("train", "validation", "test")}
        self._splits[split] = [0, len(self.images)]
        self.views, self.grades = held["views"].flatten(), held["grades"].flatten()
        self.masks, self.mask_labels = held["masks"].flatten(0, 1), MASK_LABELS
        self.scouts, self.scout_parameters = held["images"], held["parameters"]
        self.again, self.strata = held["again"], strata_of(held["distances"]).flatten()
        self._lying = {name: held[name].tolist() for name in _LYING}
        told: dict[str, Any] = {"source": "scouts", "version": PATIENTS_VERSION}
        self.manifest = told | {"digest": digest, "recipe_digest": digest}

    def measures(self) -> pa.Table:
        """Return where the patients' hearts lie, a row a patient."""
        return pa.table({"patient": self.patients} | self._lying)


_LYING = "heart_axes", "heart_origin", "heart_sway"


def asked_digest(split: str, patients: int | tuple[int, ...], seed: int) -> str:
    """Return the recipe digest of what is asked, without asking.

    Raises:
        RacinesError: as `AskedStore`.
    """
    recipe = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "strata": list(STRATA)}
    recipe |= {"frames": FRAMES, "poses": POSES, "seed": seed}
    return recipe_digest(recipe | {"patients": list(_chosen(split, patients))})


def _chosen(split: str, patients: int | tuple[int, ...]) -> tuple[int, ...]:
    """Return the seeds of so many patients of a split, its first, or those given."""
    if not isinstance(patients, int):
        check_split(list(patients), split)
        return tuple(patients)
    known = seeds_of(split)
    if not 1 <= patients <= len(known):
        raise RacinesError(f"{patients} patients: split {split!r} has 1 to {len(known)}")
    return tuple(known[:patients])


def _scanned(
    patients: tuple[int, ...], seed: int, cache: Path | None, engine: Engine
) -> Iterator[dict[str, Tensor]]:
    """Yield what is asked of each patient, with a first axis of 1."""
    paths = [None if cache is None else cache / _shard(patient, seed) for patient in patients]
    pairs = list(zip(patients, paths, strict=True))
    missing = [patient for patient, path in pairs if path is None or not path.is_file()]
    made = engine.map(_scan, seed, missing, threads=None, remedy="to go on")
    for patient, path in pairs:
        if patient not in missing:
            assert path is not None
            yield read_tensors(path, (*Scouted._fields, "views", "grades", *_LYING))
            continue
        held = next(made)
        if path is not None:
            content = {name: each.contiguous() for name, each in held.items()}
            path.parent.mkdir(parents=True, exist_ok=True)
            write_once(path, partial(save_file, content))
        yield held


def _shard(patient: int, seed: int) -> str:
    told = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "patient": patient, "seed": seed}
    return f"{patient}-{recipe_digest(told)[:16]}.safetensors"


def _scan(seed: int, patient: int) -> dict[str, Tensor]:
    pool = Pool([patient])
    found = scout(pool, seed)
    rows = torch.zeros(POSES, dtype=torch.int64)
    truth = pool.judge(parameters_to_pose(found.asked[0].double()), rows)
    lies = pool.hearts[0].placement
    where = columns(lies.axes, lies.origin, torch.zeros(3))
    held = found._asdict() | {"views": truth.view[None], "grades": truth.grade[None]}
    return held | {
        name: torch.tensor([value], dtype=torch.float64) for name, value in where.items()
    }
