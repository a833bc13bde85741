"""Packaging staged trajectories: shards, training store, card, manifest.

Rows are grouped by split and by whether they belong to the held-out session, so that the configs
`frames` and `sessions` name the same files.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from racines_data.canonical import write_canonical
from racines_data.card import write_card
from racines_data.digest import content_digest, recipe_digest
from racines_data.files import sha256_file
from racines_data.load import CARD, MANIFEST
from racines_data.schema import SPLITS, trajectory_features
from racines_data.sources import Finding, Source, Unit, labels_of_source
from racines_data.splits import divide_shards, held_out_session, shard_bounds
from racines_data.staging import open_unit, unit_path
from racines_data.store import STORE, write_store

REPORT = "import_report.parquet"
_ROW_GROUP = 256


@dataclass(frozen=True)
class _Group:
    """Rows that shards must not mix: one split, and in or out of the held-out session."""

    split: str
    held_out: bool
    members: list[int]
    rows: list[int]

    @property
    def count(self) -> int:
        return sum(self.rows)


def write_dataset(
    final: Path,
    folder: Path,
    source: Source,
    units: Sequence[Unit],
    splits: Mapping[str, str],
    recipe: dict[str, Any],
    shards: int,
) -> dict[str, Any]:
    """Write a dataset of staged units to a new folder and return its manifest.

    Args:
        final: The folder to write.
        folder: The staging folder that holds the units.
        source: What made the units, for its name, version and report.
        units: All units, in order.
        splits: Split of each unit's id.
        recipe: All that decided the bytes.
        shards: Least number of `frames` shards.
    """
    for name in ("data/frames", "data/trajectories", "store", "canonical"):
        (final / name).mkdir(parents=True)
    held = held_out_session(units)
    groups = _group(units, splits, held, folder)
    order = [index for group in groups for index in group.members]
    rows = [_trajectory_row(units[index], splits, folder, index) for index in order]
    configs = _write_configs(final, groups, rows, folder, shards)
    _write_store(final, groups, rows, folder)
    _write_report(final / REPORT, source.report)
    manifest = {
        "schema": "racines.manifest/1",
        "name": "racines",
        "source": source.name,
        "version": source.version,
        "digest": content_digest((r["split"], r["trajectory"], r["digest"]) for r in rows),
        "recipe_digest": recipe_digest(recipe),
        "recipe": recipe,
        "labels": list(labels_of_source(source)),
        "held_out_session": held,
        "counts": _counts(rows),
        "report": _report_counts(source.report),
        "configs": configs,
        "canonical": write_canonical(final, _tables(order, folder)),
    }
    (final / CARD).write_text(write_card(manifest))
    manifest["files"] = _seal(final)
    (final / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    return manifest


def _seal(final: Path) -> dict[str, dict[str, Any]]:
    paths = sorted(path for path in final.rglob("*") if path.is_file())
    return {
        path.relative_to(final).as_posix(): {
            "sha256": sha256_file(path),
            "bytes": path.stat().st_size,
        }
        for path in paths
    }


def _write_configs(
    final: Path, groups: Sequence[_Group], rows: Sequence[dict[str, Any]], folder: Path, shards: int
) -> dict[str, dict[str, list[str]]]:
    """Write the Parquet files; return the paths of each config's splits."""
    frames = _write_shards(final, groups, folder, shards)
    configs = {
        "frames": {split: [*others, *held] for split, (others, held) in frames.items()},
        "trajectories": _write_trajectories(final, rows),
    }
    held_out = [path for _, held in frames.values() for path in held]
    if held_out:
        others = [path for others, _ in frames.values() for path in others]
        configs["sessions"] = {"train": others, "test": held_out}
    return configs


def _group(
    units: Sequence[Unit], splits: Mapping[str, str], held: str | None, folder: Path
) -> list[_Group]:
    members: dict[tuple[str, bool], list[int]] = {
        (split, side): [] for split in SPLITS for side in (False, True)
    }
    for index, unit in enumerate(units):
        members[splits[unit.id], unit.session == held].append(index)
    counts = {index: len(open_unit(unit_path(folder, index))[0]) for index in range(len(units))}
    return [
        _Group(*key, chosen, [counts[index] for index in chosen]) for key, chosen in members.items()
    ]


def _trajectory_row(
    unit: Unit, splits: Mapping[str, str], folder: Path, index: int
) -> dict[str, Any]:
    table, digest = open_unit(unit_path(folder, index))
    return {
        "trajectory": unit.id,
        "session": unit.session,
        "target_view": unit.target_view,
        "phantom": table["phantom"][0].as_py(),
        "split": splits[unit.id],
        "frames": len(table),
        "duration": table["timestamp"][-1].as_py() - table["timestamp"][0].as_py(),
        "digest": digest,
    }


def _write_shards(
    final: Path, groups: Sequence[_Group], folder: Path, shards: int
) -> dict[str, tuple[list[str], list[str]]]:
    """Write the `frames` shards; return each split's paths, not held out and held out."""
    counts = divide_shards([group.count for group in groups], shards)
    paths: dict[str, tuple[list[str], list[str]]] = {}
    for split in SPLITS:
        total = sum(n for group, n in zip(groups, counts, strict=True) if group.split == split)
        sides: tuple[list[str], list[str]] = [], []
        for group, count in zip(groups, counts, strict=True):
            if group.split != split or not count:
                continue
            for start, stop in shard_bounds(group.count, count):
                number = len(sides[0]) + len(sides[1])
                name = f"data/frames/{split}-{number:05d}-of-{total:05d}.parquet"
                _write_parquet(final / name, _slice(group, folder, start, stop))
                sides[group.held_out].append(name)
        if total:
            paths[split] = sides
    return paths


def _slice(group: _Group, folder: Path, start: int, stop: int) -> pa.Table:
    parts, first = [], 0
    for index, rows in zip(group.members, group.rows, strict=True):
        low, high = max(start - first, 0), min(stop - first, rows)
        if low < high:
            table, _ = open_unit(unit_path(folder, index))
            parts.append(table.slice(low, high - low).drop_columns("pixels"))
        first += rows
    # Each unit's schema carries its own digest: what a shard says must be the features alone.
    features = {b"huggingface": (parts[0].schema.metadata or {})[b"huggingface"]}
    return pa.concat_tables([part.replace_schema_metadata(features) for part in parts])


def _write_parquet(path: Path, table: pa.Table) -> None:
    pq.write_table(table, path, row_group_size=_ROW_GROUP, compression="zstd")


def _write_trajectories(final: Path, rows: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    paths = {}
    for split in SPLITS:
        chosen = [row for row in rows if row["split"] == split]
        if chosen:
            paths[split] = [f"data/trajectories/{split}-00000-of-00001.parquet"]
            schema = trajectory_features().arrow_schema
            _write_parquet(final / paths[split][0], pa.Table.from_pylist(chosen, schema))
    return paths


def _tables(order: Sequence[int], folder: Path) -> Iterator[pa.Table]:
    return (open_unit(unit_path(folder, index))[0] for index in order)


def _write_store(
    final: Path, groups: Sequence[_Group], rows: Sequence[dict[str, Any]], folder: Path
) -> None:
    bounds, start = {}, 0
    for split in SPLITS:
        stop = start + sum(group.count for group in groups if group.split == split)
        bounds[split], start = (start, stop), stop
    order = [index for group in groups for index in group.members]
    write_store(final / STORE, _tables(order, folder), rows, bounds)


def _write_report(path: Path, report: Sequence[Finding]) -> None:
    kinds = {"file": pa.string(), "item": pa.string(), "refused": pa.bool_()}
    schema = pa.schema({**kinds, "reason": pa.string(), "frames": pa.int32()})
    rows = [dataclasses.asdict(finding) for finding in report]
    _write_parquet(path, pa.Table.from_pylist(rows, schema))


def _report_counts(report: Sequence[Finding]) -> dict[str, int]:
    refused = sum(finding.frames for finding in report if finding.refused)
    return {"refused_frames": refused, "flagged": sum(not finding.refused for finding in report)}


def _counts(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    sessions: dict[str, int] = {}
    for row in rows:
        sessions[row["session"]] = sessions.get(row["session"], 0) + row["frames"]
    splits = {}
    for split in SPLITS:
        frames = [row["frames"] for row in rows if row["split"] == split]
        splits[split] = {"trajectories": len(frames), "frames": sum(frames)}
    total = sum(row["frames"] for row in rows)
    return {"frames": total, "trajectories": len(rows), "splits": splits, "sessions": sessions}
