"""The Parquet shards of a config, written from staged trajectories.

Rows are grouped by split and by whether they belong to the held-out session, so that the configs
`frames` and `sessions` name the same files.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from racines_data.build.splits import divide_shards, shard_bounds
from racines_data.build.staging import open_unit, unit_path
from racines_data.files import write_once
from racines_data.schema import SPLITS, trajectory_features
from racines_data.sources.base import Source, Unit

_ROW_GROUP = 256


@dataclass(frozen=True)
class Part:
    """The staged trajectories of one config."""

    config: str
    """`frames` or `multi_phantom`."""
    source: Source
    units: Sequence[Unit]
    """All units, in the source's order."""
    splits: Mapping[str, str]
    """Split of each unit's id."""
    folder: Path
    """The staging folder that holds the units."""
    held_out: str | None = None
    """The session kept for test in the `sessions` config."""


@dataclass(frozen=True)
class Group:
    """Trajectories that shards must not mix: one split, and in or out of the held-out session."""

    split: str
    held_out: bool
    members: list[Path] = field(default_factory=list)
    """Files of the staged trajectories."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Their rows of the `trajectories` config."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(row["frames"] for row in self.rows)


def group_units(part: Part) -> list[Group]:
    """Return the groups of a part in the order of the dataset; some may be empty."""
    groups = {(split, side): Group(split, side) for split in SPLITS for side in (False, True)}
    for index, unit in enumerate(part.units):
        path = unit_path(part.folder, index)
        group = groups[part.splits[unit.id], unit.session == part.held_out]
        group.members.append(path)
        group.rows.append(_trajectory_row(unit, group.split, path))
    return list(groups.values())


def _trajectory_row(unit: Unit, split: str, path: Path) -> dict[str, Any]:
    table, digest = open_unit(path)
    return {
        "trajectory": unit.id,
        "session": unit.session,
        "target_view": unit.target_view,
        "phantom": table["phantom"][0].as_py(),
        "split": split,
        "frames": len(table),
        "duration": _duration(table),
        "digest": digest,
    }


def _duration(table: pa.Table) -> float | None:
    first, last = table["timestamp"][0].as_py(), table["timestamp"][-1].as_py()
    return None if first is None else last - first


def group_rows(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Return the rows of the `trajectories` config, in order."""
    return [row for group in groups for row in group.rows]


def group_tables(groups: Sequence[Group]) -> Iterator[pa.Table]:
    """Yield the staged trajectories in order, memory-mapped, one at a time."""
    return (open_unit(path)[0] for group in groups for path in group.members)


def group_bounds(groups: Sequence[Group]) -> dict[str, tuple[int, int]]:
    """Return the first and the past-the-last row of each split."""
    bounds, start = {}, 0
    for split in SPLITS:
        stop = start + sum(group.frames for group in groups if group.split == split)
        bounds[split], start = (start, stop), stop
    return bounds


def write_shards(
    final: Path, config: str, groups: Sequence[Group], shards: int, done: Callable[[int], None]
) -> dict[str, tuple[list[str], list[str]]]:
    """Write the shards of a config; a shard that is there already is left as it is.

    Args:
        final: Folder of the dataset.
        config: Name of the config, and of its folder under `data/`.
        groups: From `group_units`.
        shards: Least number of shards.
        done: Called with the number of frames of every shard that is whole.

    Returns:
        The paths of each split, not held out and held out; splits without rows are left out.
    """
    counts = divide_shards([group.frames for group in groups], shards)
    paths: dict[str, tuple[list[str], list[str]]] = {}
    for split in SPLITS:
        total = sum(n for group, n in zip(groups, counts, strict=True) if group.split == split)
        sides: tuple[list[str], list[str]] = [], []
        for group, count in zip(groups, counts, strict=True):
            if group.split != split or not count:
                continue
            for start, stop in shard_bounds(group.frames, count):
                number = len(sides[0]) + len(sides[1])
                name = f"data/{config}/{split}-{number:05d}-of-{total:05d}.parquet"
                write_once(final / name, _shard_writer(group, start, stop))
                sides[group.held_out].append(name)
                done(stop - start)
        if total:
            paths[split] = sides
    return paths


def _shard_writer(group: Group, start: int, stop: int) -> Callable[[Path], None]:
    return lambda path: write_parquet(path, _slice(group, start, stop))


def _slice(group: Group, start: int, stop: int) -> pa.Table:
    parts, first = [], 0
    for path, row in zip(group.members, group.rows, strict=True):
        low, high = max(start - first, 0), min(stop - first, row["frames"])
        if low < high:
            table, _ = open_unit(path)
            parts.append(table.slice(low, high - low).drop_columns("pixels"))
        first += row["frames"]
    # Each unit's schema carries its own digest: what a shard says must be the features alone.
    features = {b"huggingface": (parts[0].schema.metadata or {})[b"huggingface"]}
    return pa.concat_tables([part.replace_schema_metadata(features) for part in parts])


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table with row groups small enough to stream."""
    pq.write_table(table, path, row_group_size=_ROW_GROUP, compression="zstd")


def write_trajectories(final: Path, rows: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Write the `trajectories` config; return the paths of its splits."""
    paths = {}
    (final / "data" / "trajectories").mkdir(parents=True, exist_ok=True)
    for split in SPLITS:
        chosen = [row for row in rows if row["split"] == split]
        if chosen:
            paths[split] = [f"data/trajectories/{split}-00000-of-00001.parquet"]
            schema = trajectory_features().arrow_schema
            write_parquet(final / paths[split][0], pa.Table.from_pylist(chosen, schema))
    return paths
