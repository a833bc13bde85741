"""The Parquet shards of a config, written from staged trajectories.

Rows are grouped by split and by whether they belong to the held-out session, so that the configs
`frames` and `sessions` name the same files.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
Paths = dict[str, tuple[list[str], list[str]]]
"""Shards of each split that has rows: not held out, and held out."""


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

    @cached_property
    def groups(self) -> list[Group]:
        """The groups in the order of the dataset, once all is staged; some may be empty."""
        groups = {(split, side): Group(split, side) for split in SPLITS for side in (False, True)}
        for index, unit in enumerate(self.units):
            path = unit_path(self.folder, index)
            group = groups[self.splits[unit.id], unit.session == self.held_out]
            group.members.append(path)
            group.rows.append(_trajectory_row(unit, group.split, path))
        return list(groups.values())

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of the `trajectories` config, in order."""
        return [row for group in self.groups for row in group.rows]

    def tables(self) -> Iterator[pa.Table]:
        """Yield the staged trajectories in order, memory-mapped, one at a time."""
        return (open_unit(path)[0] for group in self.groups for path in group.members)


def _trajectory_row(unit: Unit, split: str, path: Path) -> dict[str, Any]:
    table, digest = open_unit(path)
    first, last = table["timestamp"][0].as_py(), table["timestamp"][-1].as_py()
    return {
        "trajectory": unit.id,
        "session": unit.session,
        "target_view": unit.target_view,
        "phantom": table["phantom"][0].as_py(),
        "split": split,
        "frames": len(table),
        "duration": None if first is None else last - first,
        "digest": digest,
    }


def write_shards(final: Path, part: Part, shards: int, done: Callable[[int], None]) -> Paths:
    """Write at least `shards` shards of a config; one that is there already is left as it is.

    `done` is called with the number of frames of every shard that is whole.
    """
    counts = divide_shards([group.frames for group in part.groups], shards)
    paths: Paths = {}
    for split in SPLITS:
        divided = [pair for pair in zip(part.groups, counts, strict=True) if pair[0].split == split]
        total = sum(count for _, count in divided)
        sides: tuple[list[str], list[str]] = [], []
        for group, count in divided:
            for start, stop in shard_bounds(group.frames, count):
                number = len(sides[0]) + len(sides[1])
                name = f"data/{part.config}/{split}-{number:05d}-of-{total:05d}.parquet"
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
            parts.append(open_unit(path)[0].slice(low, high - low).drop_columns("pixels"))
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
