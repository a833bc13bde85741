"""Packaging staged trajectories: splits, shards, training stores, card, manifest.

Neighbouring frames of a sweep are near-copies, so a trajectory is never divided among splits. The
rows of a shard are of one split, and all of them belong to the held-out session or none does,
so that the configs `frames` and `sessions` name the same files.
"""

import dataclasses
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from racines_data.build.staging import open_unit, unit_path
from racines_data.card.croissant import add_croissant
from racines_data.card.markdown import write_card
from racines_data.card.pictures import write_pictures
from racines_data.digest import content_digest, recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import naming, sha256_file, write_once
from racines_data.manifest import CARD, DIGEST_VERSION, MANIFEST, MULTI_PHANTOM, REPORT, store_name
from racines_data.progress import progress_bar
from racines_data.records import MASK_PIXELS, RAW_PIXELS
from racines_data.schema import PARAMETERS, SPLITS, trajectory_features
from racines_data.sources.base import Finding, Source, Unit, has_poses, labels_of_source
from racines_data.sources.gate.bounds import Bounds, to_manifest
from racines_data.store.sweeps import write_store

_ROW_GROUP = 256
SHARD_FRAMES = 2048  # most frames in a shard: a full dataset has more shards, not larger ones
Paths = dict[str, tuple[list[str], list[str]]]  # shards by split: not held out, and held out


@dataclass(frozen=True)
class Group:
    """Trajectories that shards must not mix: one split, and in or out of the held-out session."""

    split: str
    held_out: bool
    members: list[Path] = field(default_factory=list)  # files of the staged trajectories
    rows: list[dict[str, Any]] = field(default_factory=list)  # theirs of the `trajectories` config

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(row["frames"] for row in self.rows)


@dataclass(frozen=True)
class Part:
    """The staged trajectories of one config."""

    config: str  # `frames`, `multi_phantom`, or what a source adds
    source: Source
    units: Sequence[Unit]  # all, in the source's order
    splits: Mapping[str, str]  # split of each unit's id
    folder: Path  # the staging folder that holds the units
    held_out: str | None = None  # the session kept for test in the `sessions` config

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
        **({"patient": table["patient"][0].as_py()} if "patient" in table.column_names else {}),
    }


def write_dataset(
    final: Path,
    main: Part,
    many: Part | None,
    recipe: dict[str, Any],
    shards: int,
    progress: bool = False,
    bounds: Bounds | None = None,
    card: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Write a dataset of staged units, at least `shards` shards a config; return its manifest.

    Shards and stores that a killed run has left in `final` are kept. `many` is `multi_phantom`,
    `recipe` all that decided the bytes, `bounds` the gate's, `card` what the dataset has to hold.
    """
    _keep_finished(final)
    source, rows = main.source, main.rows
    manifest: dict[str, Any] = {
        "schema": "racines.manifest/1",
        "name": "racines",
        "source": source.name,
        "version": source.version,
        "tag": f"{source.name}-v{source.version}",
        "digest": digest_rows(rows, source.name),
        "digest_version": DIGEST_VERSION,
        "recipe_digest": recipe_digest(recipe),
        "recipe": recipe,
        "labels": list(labels_of_source(source)),
        "poses": has_poses(source),
        **({"card": card} if card else {}),
        **to_manifest(bounds or Bounds()),
        **getattr(source, "told", {}),
        "held_out_session": main.held_out,
        "counts": _counts(rows),
        "report": {
            "refused_frames": sum(each.frames for each in source.report if each.refused),
            "flagged": sum(not each.refused for each in source.report),
        },
        "configs": _configs(write_part(final, main, shards, progress)),
        "canonical": write_canonical(final, main.tables()),
    }
    manifest["configs"]["trajectories"] = _write_trajectories(final, rows)
    if many is not None:
        paths = write_part(final, many, shards, progress)
        manifest["configs"][many.config] = {split: others for split, (others, _) in paths.items()}
        canonical = write_canonical(final, many.tables(), f"canonical/{many.config}")
        counted = count_wholes(many.rows, "hearts") | {
            "digest": digest_rows(many.rows, source.name)
        }
        manifest[MULTI_PHANTOM] = {**counted, "canonical": canonical}
    _write_report(final / REPORT, source.report)
    write_pictures(final, manifest)
    (final / CARD).write_text(write_card(manifest), encoding="utf-8")
    manifest["files"] = _seal(final)
    add_croissant(manifest, final)
    (final / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return manifest


def _keep_finished(final: Path) -> None:
    """Make the folder, or clear what a killed run has left there but for whole shards, stores."""
    final.mkdir(parents=True, exist_ok=True)
    for path in [path for path in final.rglob("*") if path.is_file()]:
        whole = path.suffix in (".parquet", ".arrow")
        if not whole or path.parent.name not in ("frames", MULTI_PHANTOM, "store"):
            path.unlink()


def write_part(final: Path, part: Part, shards: int, progress: bool) -> Paths:
    """Write a config's shards and its store, where they are not there; return the shards' paths."""
    rows = part.rows
    paths: Paths = {}
    counts = divide_shards([group.frames for group in part.groups], shards)
    divided = list(zip(part.groups, counts, strict=True))
    with progress_bar(progress) as bar:
        task = bar.add_task(f"{part.config} shards", total=sum(row["frames"] for row in rows))
        for split in SPLITS:
            own = [(group, count) for group, count in divided if group.split == split]
            total = sum(count for _, count in own)
            sides: tuple[list[str], list[str]] = [], []
            for group, count in own:
                for start, stop in shard_bounds(group.frames, count):
                    number = len(sides[0]) + len(sides[1])
                    name = f"data/{part.config}/{split}-{number:05d}-of-{total:05d}.parquet"
                    write_once(final / name, partial(_write_shard, group, start, stop))
                    sides[group.held_out].append(name)
                    bar.advance(task, stop - start)
            if total:
                paths[split] = sides
    write_once(final / store_name(part.config), lambda path: write_store(path, part.tables, rows))
    return paths


def _write_shard(group: Group, start: int, stop: int, path: Path) -> None:
    parts, first = [], 0
    for member, row in zip(group.members, group.rows, strict=True):
        low, high = max(start - first, 0), min(stop - first, row["frames"])
        if low < high:
            rows = open_unit(member)[0].slice(low, high - low)
            parts.append(rows.drop_columns(list({RAW_PIXELS, MASK_PIXELS} & {*rows.column_names})))
        first += row["frames"]
    # Each unit's schema carries its own digest: what a shard says must be the features alone.
    features = {b"huggingface": (parts[0].schema.metadata or {})[b"huggingface"]}
    parts = [part.replace_schema_metadata(features) for part in parts]
    write_parquet(path, pa.concat_tables(parts))


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table with row groups small enough to stream."""
    with naming(path):
        pq.write_table(table, path, row_group_size=_ROW_GROUP, compression="zstd")


def _write_trajectories(final: Path, rows: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Write the `trajectories` config; return the paths of its splits."""
    paths = {}
    (final / "data" / "trajectories").mkdir(parents=True, exist_ok=True)
    for split, chosen in _by_split(rows).items():
        if chosen:
            paths[split] = [f"data/trajectories/{split}-00000-of-00001.parquet"]
            schema = trajectory_features().arrow_schema
            write_parquet(final / paths[split][0], pa.Table.from_pylist(chosen, schema))
    return paths


def _configs(frames: Paths) -> dict[str, dict[str, list[str]]]:
    """Return the paths of the splits of `frames`, and of `sessions` if a session is held out."""
    configs = {"frames": {split: [*others, *held] for split, (others, held) in frames.items()}}
    held_out = [path for _, held in frames.values() for path in held]
    if held_out:
        others = [path for others, _ in frames.values() for path in others]
        configs["sessions"] = {"train": others, "test": held_out}
    return configs


def write_canonical(
    final: Path, tables: Iterable[pa.Table], folder: str = "canonical"
) -> list[dict[str, Any]]:
    """Write the middle frame of the first trajectory of each target view, and return its figures.

    `tables` are rows of `frames`, one table a trajectory, in the dataset's order.
    """
    (final / folder).mkdir(parents=True, exist_ok=True)
    chosen: dict[str, dict[str, Any]] = {}
    for table in tables:
        view = table["target_view"][0].as_py()
        if view in chosen:
            continue
        row = table.slice(len(table) // 2, 1).to_pylist()[0]
        name = f"{folder}/{view}.png"
        (final / name).write_bytes(row["image"]["bytes"])
        keys = "trajectory", "frame", "target_view"
        parameters = {key: row[key] for key in PARAMETERS}
        chosen[view] = {"file": name, **{key: row[key] for key in keys}, "parameters": parameters}
    return list(chosen.values())


def digest_rows(rows: Sequence[dict[str, Any]], source: str) -> str:
    """Return the content digest of rows of the `trajectories` config, in order."""
    return content_digest(
        ((row["split"], row["trajectory"], row["digest"]) for row in rows), source
    )


def _counts(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    sessions: Counter[str] = Counter()
    for row in rows:
        sessions[row["session"]] += row["frames"]
    return {
        "frames": sessions.total(),
        "trajectories": len(rows),
        "splits": {split: _size(chosen) for split, chosen in _by_split(rows).items()},
        "sessions": dict(sessions),
    }


def count_wholes(rows: Sequence[dict[str, Any]], wholes: str) -> dict[str, Any]:
    """Count trajectories, frames, and sessions, which are called `wholes`; in all and by split."""

    def counts(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
        return {wholes: len({row["session"] for row in rows}), **_size(rows)}

    splits = {split: counts(chosen) for split, chosen in _by_split(rows).items()}
    return {**counts(rows), "splits": splits}


def _by_split(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    return {split: [row for row in rows if row["split"] == split] for split in SPLITS}


def _size(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    return {"trajectories": len(rows), "frames": sum(row["frames"] for row in rows)}


def _seal(final: Path) -> dict[str, dict[str, Any]]:
    paths = sorted(path for path in final.rglob("*") if path.is_file())
    with ThreadPoolExecutor(2) as pool:  # hashing leaves the interpreter free
        digests = list(pool.map(sha256_file, paths))
    return {
        path.relative_to(final).as_posix(): {"sha256": digest, "bytes": path.stat().st_size}
        for path, digest in zip(paths, digests, strict=True)
    }


def _write_report(path: Path, report: Sequence[Finding]) -> None:
    kinds = {"file": pa.string(), "item": pa.string(), "refused": pa.bool_()}
    schema = pa.schema({**kinds, "reason": pa.string(), "frames": pa.int32()})
    rows = [dataclasses.asdict(finding) for finding in report]
    write_parquet(path, pa.Table.from_pylist(rows, schema))


# --- splits ---------------------------------------------------------------------------------------


def assign_splits(
    units: Sequence[Unit], validation: float, test: float, seed: int
) -> dict[str, str]:
    """Return the split of each trajectory id, stratified by target view.

    A view with three trajectories or more is in every split. Views with fewer are pooled. Two
    trajectories in all make train and test; one makes train.

    Raises:
        RacinesError: the shares do not leave anything to train on.
    """
    if not (0 <= validation < 1 and 0 <= test < 1 and validation + test < 1):
        raise RacinesError(
            f"data.validation {validation} and data.test {test}: shares must lie in [0, 1) and "
            "leave something to train on"
        )
    splits: dict[str, str] = {}
    for stratum in _strata(units):
        ranked = sorted(stratum, key=lambda unit: _rank(unit.id, seed))
        tested = _share(len(ranked), test, len(ranked) - 1)
        validated = _share(len(ranked), validation, len(ranked) - 1 - tested)
        if len(ranked) == len(units) == 2:
            tested = int(test > 0)
        for index, unit in enumerate(ranked):
            held = "test" if index < tested else "validation"
            splits[unit.id] = held if index < tested + validated else "train"
    return splits


def assign_group_splits(
    units: Sequence[Unit], validation: float, test: float, seed: int
) -> dict[str, str]:
    """Return the split of each trajectory id such that a session is in one split."""
    sessions = dict.fromkeys(unit.session for unit in units)
    wholes = [Unit(name, name, "", 0) for name in sessions]
    splits = assign_splits(wholes, validation, test, seed)
    return {unit.id: splits[unit.session] for unit in units}


def _strata(units: Sequence[Unit]) -> list[list[Unit]]:
    by_view: dict[str, list[Unit]] = defaultdict(list)
    for unit in units:
        by_view[unit.target_view].append(unit)
    large = [group for group in by_view.values() if len(group) >= 3]
    pooled = [unit for group in by_view.values() if len(group) < 3 for unit in group]
    return [*large, pooled] if pooled else large


def _rank(unit_id: str, seed: int) -> str:
    return hashlib.sha256(f"{seed}/{unit_id}".encode()).hexdigest()


def _share(count: int, share: float, most: int) -> int:
    if count < 3 or not share:
        return 0
    return min(max(1, int(count * share + 0.5)), most)


def held_out_session(units: Sequence[Unit]) -> str | None:
    """Return the session kept for test in the `sessions` config: the last by name, if several."""
    sessions = sorted({unit.session for unit in units})
    return sessions[-1] if len(sessions) > 1 else None


def divide_shards(rows: Sequence[int], shards: int) -> list[int]:
    """Return the number of shards of each group of rows, in proportion, at least one each.

    In total `shards` or more where a shard would be too large, never more than there are rows.
    """
    wanted = min(max(shards, -(-sum(rows) // SHARD_FRAMES)), sum(rows))
    counts = [1 if count else 0 for count in rows]
    while sum(counts) < wanted:
        largest = max(range(len(rows)), key=lambda i: rows[i] / counts[i] if counts[i] else 0.0)
        counts[largest] += 1
    return counts


def shard_bounds(rows: int, shards: int) -> list[tuple[int, int]]:
    """Return (start, stop) of each shard of a group of rows, of sizes that differ by one."""
    return [(rows * i // shards, rows * (i + 1) // shards) for i in range(shards)]
