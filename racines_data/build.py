"""Building a dataset: one writer, whatever the source.

    source.plan() ─> staged units ─> groups by (split, held-out session) ─> Parquet shards
                                                                         └> training store
                  ─> manifest.json, README.md, canonical frames, import report ─> swapped in place

Nothing of the result depends on the time, the number of workers or the order they finish in.
"""

import dataclasses
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.config import fill
from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.load import MANIFEST
from racines_data.sources import Finding, Source, Unit, source_class, source_names
from racines_data.splits import assign_splits
from racines_data.staging import stage_units, staging_folder
from racines_data.writer import write_dataset

FORMAT = 2
"""Version of the layout of units, shards and store; part of every recipe."""


@dataclass(frozen=True)
class DataConfig:
    """How a dataset is built. Settings of a source stand in a section of its name beside these."""

    source: str = "phantom"
    """Name of the source."""
    frames: int = 6000
    """Frames to acquire, where the source can choose."""
    seed: int = 0
    """Seed of the acquisition and of the splits."""
    workers: int = 2
    """Worker processes; the result does not depend on it."""
    shards: int = 16
    """Parquet shards of `frames`, at least (never more than there are frames)."""
    validation: float = 0.15
    """Share of trajectories for validation."""
    test: float = 0.15
    """Share of trajectories for test."""
    strict: bool = False
    """Stop at the first input that is refused."""
    max_refused: float = 0.2
    """Largest share of frames that may be refused."""


def read_data_section(values: Mapping[str, Any]) -> tuple[DataConfig, dict[str, dict[str, Any]]]:
    """Split the `data` section of a params file into the builder's part and the sources' parts.

    Raises:
        RacinesError: an unknown key, or a value of the wrong type.
    """
    names = source_names()
    sections = {key: dict(value or {}) for key, value in values.items() if key in names}
    rest = {key: value for key, value in values.items() if key not in names}
    return fill(DataConfig, rest, "data"), sections


def make_source(
    config: DataConfig, section: Mapping[str, Any] | None = None, inputs: Sequence[Path] = ()
) -> Source:
    """Make the source that a config names; it gets `frames` and `seed` if it has such settings.

    Raises:
        RacinesError: no such source, or it refuses its settings or inputs.
    """
    kind = source_class(config.source)
    known = {field.name for field in dataclasses.fields(kind.Config)}
    shared = {"frames": config.frames, "seed": config.seed}
    given = {key: value for key, value in shared.items() if key in known}
    return kind.from_config({**given, **(section or {})}, inputs)


def build(
    source: Source,
    out: Path,
    config: DataConfig | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Build a dataset and swap it into place; a build that was killed goes on where it stopped.

    Args:
        source: Where the trajectories come from.
        out: Folder of the dataset. An older dataset there is replaced when the new one is whole.
        config: Splits, shards, workers, limits.
        progress: Show a progress bar on stderr.

    Returns:
        The manifest.

    Raises:
        RacinesError: the source refuses its input, too much is refused, `out` holds something
            else, or another build of it is running.
    """
    config = config or DataConfig()
    out = out.resolve()  # a link to the dataset stays a link
    _check_out(out)
    if config.workers < 1 or config.shards < 1:
        raise RacinesError("data.workers and data.shards must be one or more")
    units = list(source.plan())
    _check_report(source.report, units, config)
    _check_units(units, source)
    splits = assign_splits(units, config.validation, config.test, config.seed)
    recipe = _recipe(source, config)
    out.parent.mkdir(parents=True, exist_ok=True)
    with staging_folder(out, source, recipe_digest(recipe)) as folder:
        stage_units(source, units, folder, config.workers, progress)
        final = folder / "final"
        shutil.rmtree(final, ignore_errors=True)
        manifest = write_dataset(final, folder, source, units, splits, recipe, config.shards)
        _swap(final, out)
    return manifest


def _recipe(source: Source, config: DataConfig) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "source": source.name,
        "version": source.version,
        "splits": {"seed": config.seed, "validation": config.validation, "test": config.test},
        "settings": source.recipe(),
    }


def _check_out(out: Path) -> None:
    old = _aside(out)
    if old.exists() and not out.exists():
        os.replace(old, out)  # killed between the two renames of a swap
    if out.exists() and not (out / MANIFEST).is_file() and (out.is_file() or any(out.iterdir())):
        raise RacinesError(f"{out}: exists and is not a dataset; name another --out or remove it")


def _check_units(units: Sequence[Unit], source: Source) -> None:
    if not units:
        raise RacinesError(f"source {source.name}: no trajectory to build from")
    ids = [unit.id for unit in units]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise RacinesError(f"source {source.name}: trajectory {twice!r} occurs twice")


def _check_report(report: Sequence[Finding], units: Sequence[Unit], config: DataConfig) -> None:
    refused = [finding for finding in report if finding.refused]
    if not refused:
        return
    first = f"{refused[0].file} {refused[0].item}: {refused[0].reason}"
    if config.strict:
        raise RacinesError(f"refused (--strict): {first}")
    lost = sum(finding.frames for finding in refused)
    total = lost + sum(unit.frames for unit in units)
    if lost > config.max_refused * total:
        raise RacinesError(
            f"{lost} of {total} frames refused, more than max_refused {config.max_refused}; "
            f"first: {first}"
        )


def _aside(out: Path) -> Path:
    return out.parent / f".{out.name}.old"


def _swap(final: Path, out: Path) -> None:
    old = _aside(out)
    shutil.rmtree(old, ignore_errors=True)
    if out.exists():
        os.replace(out, old)
    os.replace(final, out)
    shutil.rmtree(old, ignore_errors=True)
