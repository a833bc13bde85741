"""Packaging staged trajectories: shards, training stores, card, manifest."""

import dataclasses
import json
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pyarrow as pa

from racines_data.build.canonical import write_canonical
from racines_data.build.shards import Part, Paths, write_parquet, write_shards, write_trajectories
from racines_data.card.croissant import add_croissant
from racines_data.card.markdown import write_card
from racines_data.card.pictures import write_pictures
from racines_data.digest import content_digest, recipe_digest
from racines_data.files import sha256_file, write_once
from racines_data.manifest import CARD, MANIFEST, MULTI_PHANTOM, store_name
from racines_data.progress import progress_bar
from racines_data.schema import SPLITS
from racines_data.sources.base import Finding, has_poses, labels_of_source
from racines_data.sources.card import own_card
from racines_data.store.writer import write_store

REPORT = "import_report.parquet"


def write_dataset(
    final: Path,
    main: Part,
    many: Part | None,
    recipe: dict[str, Any],
    shards: int,
    progress: bool = False,
) -> dict[str, Any]:
    """Write a dataset of staged units and return its manifest.

    Args:
        final: The folder to write; shards and stores that a killed run has left in it are kept.
        main: The `frames`.
        many: The `multi_phantom` config, if there is one.
        recipe: All that decided the bytes.
        shards: Least number of shards of a config.
        progress: Show a progress bar on stderr.
    """
    _keep_finished(final)
    source, rows = main.source, main.rows
    manifest: dict[str, Any] = {
        "schema": "racines.manifest/1",
        "name": "racines",
        "source": source.name,
        "version": source.version,
        "tag": f"{source.name}-v{source.version}",
        "digest": _digest(rows),
        "recipe_digest": recipe_digest(recipe),
        "recipe": recipe,
        "labels": list(labels_of_source(source)),
        "poses": has_poses(source),
        **({"card": dataclasses.asdict(card)} if (card := own_card(source)) else {}),
        "held_out_session": main.held_out,
        "counts": _counts(rows),
        "report": _report_counts(source.report),
        "configs": _configs(_write_part(final, main, shards, progress)),
        "canonical": write_canonical(final, main.tables()),
    }
    manifest["configs"]["trajectories"] = write_trajectories(final, rows)
    if many is not None:
        paths = _write_part(final, many, shards, progress)
        manifest["configs"][many.config] = {split: others for split, (others, _) in paths.items()}
        canonical = write_canonical(final, many.tables(), f"canonical/{many.config}")
        manifest[MULTI_PHANTOM] = {**_count_hearts(many.rows), "canonical": canonical}
    _write_report(final / REPORT, source.report)
    write_pictures(final, manifest)
    (final / CARD).write_text(write_card(manifest))
    manifest["files"] = _seal(final)
    add_croissant(manifest, final)
    (final / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    return manifest


def _keep_finished(final: Path) -> None:
    """Make the folder, or clear what a killed run has left there but for whole shards, stores."""
    final.mkdir(parents=True, exist_ok=True)
    for path in [path for path in final.rglob("*") if path.is_file()]:
        whole = path.suffix in (".parquet", ".arrow")
        if not whole or path.parent.name not in ("frames", MULTI_PHANTOM, "store"):
            path.unlink()


def _write_part(final: Path, part: Part, shards: int, progress: bool) -> Paths:
    """Write a config's shards and store; return the paths of the shards."""
    rows = part.rows
    with progress_bar(progress) as bar:
        task = bar.add_task(f"{part.config} shards", total=sum(row["frames"] for row in rows))
        paths = write_shards(final, part, shards, lambda count: bar.advance(task, count))
    write_once(final / store_name(part.config), lambda path: write_store(path, part.tables, rows))
    return paths


def _configs(frames: Paths) -> dict[str, dict[str, list[str]]]:
    """Return the paths of the splits of `frames`, and of `sessions` if a session is held out."""
    configs = {"frames": {split: [*others, *held] for split, (others, held) in frames.items()}}
    held_out = [path for _, held in frames.values() for path in held]
    if held_out:
        others = [path for others, _ in frames.values() for path in others]
        configs["sessions"] = {"train": others, "test": held_out}
    return configs


def _digest(rows: Sequence[dict[str, Any]]) -> str:
    return content_digest((row["split"], row["trajectory"], row["digest"]) for row in rows)


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


def _count_hearts(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    def counts(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
        return {"hearts": len({row["session"] for row in rows}), **_size(rows)}

    splits = {split: counts(chosen) for split, chosen in _by_split(rows).items()}
    return {**counts(rows), "splits": splits, "digest": _digest(rows)}


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


def _report_counts(report: Sequence[Finding]) -> dict[str, int]:
    refused = sum(finding.frames for finding in report if finding.refused)
    return {"refused_frames": refused, "flagged": sum(not finding.refused for finding in report)}
