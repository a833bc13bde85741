"""Checking a built dataset: files, digests, splits, ranges, and the parameters' statistics."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch

from racines_data.canonical import same_version
from racines_data.card import describe
from racines_data.digest import content_digest, recipe_digest, trajectory_digest
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.load import CARD, manifest_labels, read_manifest
from racines_data.records import check_trajectory, features_of, table_to_trajectory
from racines_data.schema import PARAMETERS, SPLITS, Trajectory
from racines_data.sources import Unit
from racines_data.store import FrameStore
from racines_data.views import PAPER_STATISTICS, ParameterStatistics

LIMITS = {"force": 200.0, "torque": 50.0, "position": 10.0, "rotation": math.pi + 1e-5}
"""Largest absolute value of a parameter by its kind: N, N·m, m, rad."""


@dataclass(frozen=True)
class Check:
    """One property of a dataset, and whether it holds."""

    name: str
    ok: bool
    detail: str


@dataclass(frozen=True)
class Validation:
    """What was checked, and the statistics of the twelve parameters."""

    manifest: dict[str, Any]
    checks: list[Check] = field(default_factory=list)
    statistics: dict[str, ParameterStatistics] = field(default_factory=dict)
    """Of the parameters that were measured at all."""

    @property
    def ok(self) -> bool:
        """Whether every check holds."""
        return all(check.ok for check in self.checks)


def validate(root: Path, against: Path | None = None) -> Validation:
    """Check a dataset, reading every byte of it.

    Args:
        root: Folder of the dataset.
        against: Another build that should be the same version.

    Raises:
        RacinesError: there is no dataset.
    """
    manifest = read_manifest(root)
    result = Validation(manifest)
    checks: dict[str, Callable[[Path, dict[str, Any]], str]] = {
        "files": _check_files,
        "card": _check_card,
        "recipe": _check_recipe,
        "rows": _check_rows,
        "splits": _check_splits,
        "store": _check_store,
    }
    if against is not None:
        checks["same version"] = lambda root, _: same_version(root, against)
    for name, check in checks.items():
        try:
            result.checks.append(Check(name, True, check(root, manifest)))
        except (RacinesError, pa.ArrowException, OSError, KeyError, ValueError) as error:
            result.checks.append(Check(name, False, f"{error}"))
    if next(check.ok for check in result.checks if check.name == "store"):
        result.statistics.update(parameter_statistics(FrameStore(root)))
    return result


def _check_files(root: Path, manifest: dict[str, Any]) -> str:
    for name, record in manifest["files"].items():
        path = root / name
        if not path.is_file():
            raise RacinesError(f"{name} is missing")
        if sha256_file(path) != record["sha256"]:
            raise RacinesError(f"{name} is damaged: its sha256 differs")
    size = sum(record["bytes"] for record in manifest["files"].values())
    return f"{len(manifest['files'])} files, {size / 1e6:.1f} MB, every sha256 as recorded"


def _check_card(root: Path, manifest: dict[str, Any]) -> str:
    if describe(manifest) not in (root / CARD).read_text():
        raise RacinesError(f"{CARD} describes another dataset: its digest or source differs")
    return "names the source and the content digest"


def _check_recipe(root: Path, manifest: dict[str, Any]) -> str:
    if recipe_digest(manifest["recipe"]) != manifest["recipe_digest"]:
        raise RacinesError("the recipe does not have the recorded recipe digest")
    return manifest["recipe_digest"][:16]


def _check_rows(root: Path, manifest: dict[str, Any]) -> str:
    """Check each row's schema, image and numbers, and that all together have the digest."""
    digests: list[tuple[str, str, str]] = []
    counts: dict[str, int] = dict.fromkeys(SPLITS, 0)
    for split, trajectory in _trajectories(root, manifest):
        unit = Unit(trajectory.id, trajectory.session, trajectory.target_view, len(trajectory))
        check_trajectory(trajectory, unit, manifest_labels(manifest))
        _check_ranges(trajectory)
        digests.append((split, trajectory.id, trajectory_digest(trajectory)))
        counts[split] += len(trajectory)
    recorded = {name: count["frames"] for name, count in manifest["counts"]["splits"].items()}
    if counts != recorded:
        raise RacinesError(f"frames {counts}, recorded {recorded}")
    if content_digest(digests) != manifest["digest"]:
        raise RacinesError("the rows do not have the recorded content digest")
    return f"{sum(counts.values())} frames, content {manifest['digest'][:16]}"


def _trajectories(root: Path, manifest: dict[str, Any]) -> Iterator[tuple[str, Trajectory]]:
    """Yield every trajectory of the `frames` shards in order; one may cross shards."""
    schema = features_of(manifest["source"], manifest_labels(manifest)).arrow_schema
    for split, names in manifest["configs"]["frames"].items():
        pending = schema.empty_table()
        for name in names:
            table = pq.read_table(root / name)
            if not table.schema.equals(schema):
                raise RacinesError(f"{name}: columns differ from the schema of `frames`")
            pending = pa.concat_tables([pending, table])
            starts = [0, *_beginnings(pending)]
            for start, stop in pairwise(starts):
                yield split, table_to_trajectory(pending.slice(start, stop - start))
            pending = pending.slice(starts[-1])
        yield split, table_to_trajectory(pending)


def _beginnings(table: pa.Table) -> list[int]:
    """Return the rows at which another trajectory begins."""
    ids = table["trajectory"].to_numpy()
    return [int(row) for row in np.flatnonzero(ids[1:] != ids[:-1]) + 1]


def _check_ranges(trajectory: Trajectory) -> None:
    for index, name in enumerate(PARAMETERS):
        limit = LIMITS[name.partition("_")[0]]
        if (np.abs(trajectory.parameters[:, index]) > limit).any():
            raise RacinesError(f"trajectory {trajectory.id}: {name} exceeds ±{limit:.4g}")


def _check_splits(root: Path, manifest: dict[str, Any]) -> str:
    seen: dict[str, str] = {}
    for split, names in manifest["configs"]["frames"].items():
        for name in names:
            ids = pq.read_table(root / name, columns=["trajectory"])["trajectory"]
            for trajectory in ids.unique().to_pylist():
                if seen.setdefault(trajectory, split) != split:
                    raise RacinesError(
                        f"trajectory {trajectory} is in {split} and in {seen[trajectory]}"
                    )
    listed = {
        row["trajectory"]: row["split"]
        for names in manifest["configs"]["trajectories"].values()
        for name in names
        for row in pq.read_table(root / name).to_pylist()
    }
    if listed != seen:
        raise RacinesError("configs `frames` and `trajectories` disagree on trajectories or splits")
    return f"{len(seen)} trajectories, each in one split"


def _check_store(root: Path, manifest: dict[str, Any]) -> str:
    """Check that the training store holds the same rows as the shards."""
    store, start = FrameStore(root), 0
    for split, trajectory in _trajectories(root, manifest):
        rows = slice(start, start + len(trajectory))
        place = store.trajectory_index[rows]
        same = (
            store.trajectories[int(place[0])] == trajectory.id
            and bool((place == place[0]).all())
            and np.array_equal(store.images[rows].numpy(), trajectory.images)
            and _equal(store.parameters[rows], trajectory.parameters)
            and _equal(store.controls[rows], trajectory.controls)
            and _equal(store.grades[rows], trajectory.grades)
            and np.array_equal(store.views[rows].numpy(), trajectory.views)
            and start in range(*store.bounds(split))
        )
        if not same:
            raise RacinesError(f"trajectory {trajectory.id} differs between store and shards")
        start = rows.stop
    if start != len(store):
        raise RacinesError(f"the store has {len(store)} frames, the shards {start}")
    return f"{len(store)} frames, equal to the shards"


def _equal(stored: torch.Tensor, column: np.ndarray) -> bool:
    return np.array_equal(stored.numpy(), column, equal_nan=True)


def parameter_statistics(store: FrameStore) -> dict[str, ParameterStatistics]:
    """Return minimum, maximum, mean and standard deviation of each parameter that is there."""
    statistics = {}
    for index, name in enumerate(PARAMETERS):
        values = store.parameters[:, index].to(torch.float64)
        values = values[~values.isnan()]
        if len(values):
            moments = values.min(), values.max(), values.mean(), values.std(correction=0)
            statistics[name] = ParameterStatistics(*(float(moment) for moment in moments))
    return statistics


def to_json(result: Validation) -> dict[str, Any]:
    """Return a validation as JSON, the paper's statistics beside the phantom's."""
    paper = PAPER_STATISTICS if has_paper(result.manifest) else {}
    statistics = {
        name: {**vars(value), "paper": vars(paper[name]) if name in paper else None}
        for name, value in result.statistics.items()
    }
    keys = ("source", "version", "digest", "recipe_digest", "counts")
    return {
        **{key: result.manifest[key] for key in keys},
        "ok": result.ok,
        "checks": [vars(check) for check in result.checks],
        "statistics": statistics,
    }


def has_paper(manifest: dict[str, Any]) -> bool:
    """Return whether the paper's statistics are the measure of this source."""
    return manifest["source"] in ("phantom", "release")
