"""Writing a grader's view and grade into the `frames` of a dataset.

    store ──> grader ──> opinions/*.safetensors ──> new shards, card, manifest ──> swapped in place

The opinions go into `view_predicted` and `grade_predicted` alone: all other bytes of the rows stay
as they were, and with them the content digest. The card names the grader, so that no reader is
served rows of before.
"""

import json
import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from racines_data.card.croissant import CROISSANT, add_croissant
from racines_data.card.markdown import write_card
from racines_data.digest import canonical_json, check_files
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import (
    locked_place,
    read_tensors,
    recover_folder,
    sha256_file,
    swap_folder,
    working_folder,
    write_once,
)
from racines_data.manifest import CARD, MANIFEST, read_manifest, rebuild_hint
from racines_data.schema import SPLITS
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.report import compare
from racines_models.sample import Progress
from racines_models.weights import save_weights

BATCH = 256
"""Images judged at once."""


def annotate(
    root: Path,
    grader: Grader,
    out: Path | None = None,
    progress: Progress | None = None,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Fill `view_predicted` and `grade_predicted` of every frame of a dataset.

    A run that was killed goes on where it stopped; until the last rename the old dataset stands.
    Without `out`, the dataset itself is replaced. `progress` is told of images judged.
    An `engine` that is started judges them, a batch a task; else this process does.

    Returns:
        The manifest; its `annotation` names the grader and how it agrees with known views and
        grades, by split.

    Raises:
        RacinesError: no dataset, a damaged one or one that changed meanwhile, a grader of other
            labels or without weights on disk, or an `out` that holds something else.
    """
    root = Path(root).resolve()
    out = root if out is None else Path(out).resolve()
    recover_folder(out)
    if out.exists() and not (out / MANIFEST).is_file() and (out.is_file() or any(out.iterdir())):
        raise RacinesError(f"{out}: exists and is not a dataset; name another --out or remove it")
    manifest, store = read_manifest(root), FrameStore(root)
    files = dict(manifest["files"])
    grader.check_labels(store.labels, "the dataset")
    if grader.sha256 is None:
        raise RacinesError("the grader has no weights on disk to be named by: save it first")
    shards = _shards(root, manifest, store)
    key = canonical_json([manifest["files"], grader.settings, str(out)])
    busy = "it is being annotated already; wait for it"
    with working_folder(out, "annotating", key, busy) as folder:
        opinions = _judge_all(
            store, grader, shards, folder / "opinions", progress, engine or LocalEngine()
        )
        manifest["annotation"] = {
            "grader": grader.sha256,
            "settings": grader.settings,
            "frames": len(opinions),
            "agreement": agreement(store, opinions),
        }
        final = folder / "final"
        rewritten = {CARD, CROISSANT, *shards}
        for name in sorted(manifest["files"].keys() - rewritten):
            write_once(final / name, partial(_bring, (root / name).resolve(), out == root))
        for name, rows in shards.items():
            write_once(final / name, partial(_write_shard, root / name, opinions[rows]))
        _seal(final, manifest, shards)
        with locked_place(out):
            if out == root and read_manifest(root)["files"] != files:
                raise RacinesError(f"{root}: changed while it was annotated; annotate it again")
            swap_folder(final, out)
    return manifest


def agreement(store: FrameStore, opinions: np.ndarray) -> dict[str, Any]:
    """Return how (N, 2) views and grades agree with those known, by split; empty where none is."""
    found: dict[str, Any] = {}
    for split in SPLITS:
        rows = store.split_indices(split)
        label, grade = torch.from_numpy(opinions[rows.numpy()]).unbind(1)
        views, grades = store.views[rows], store.grades[rows]
        compared = compare(label.long(), grade, views, grades, len(store.labels) - 1)
        trajectory = store.trajectory_index[rows].numpy()
        if compared:
            found[split] = {name: each.mean(trajectory) for name, each in compared.items()}
    return found


def _shards(root: Path, manifest: dict[str, Any], store: FrameStore) -> dict[str, slice]:
    """Return the files of `frames` in the order of the store, and the rows of each."""
    names = [name for split in manifest["configs"]["frames"].values() for name in split]
    # All that will be carried over must be whole, or damage would be sealed anew.
    check_files(root, manifest["files"], rebuild_hint(manifest))
    shards, start = {}, 0
    for name in names:
        table = pq.read_table(root / name, columns=["trajectory", "frame"])
        rows = slice(start, start + len(table))
        ids = [store.trajectories[i] for i in store.trajectory_index[rows].tolist()]
        numbers = store.frame[rows].tolist()
        if (table["trajectory"].to_pylist(), table["frame"].to_pylist()) != (ids, numbers):
            raise RacinesError(f"{root / name}: its rows are not those of the training store")
        shards[name], start = rows, rows.stop
    return shards


def _judge_all(
    store: FrameStore, grader: Grader, shards: dict[str, slice], folder: Path,
    told: Progress | None, engine: Engine,
) -> np.ndarray:  # fmt: skip
    """Return (N, 2) float32 views and grades, judged shard by shard; those on disk are kept."""
    paths = {name: folder / f"{Path(name).stem}.safetensors" for name in shards}
    missing = [name for name in shards if not paths[name].exists()]
    batches = (each for name in missing for each in store.images[shards[name]].split(BATCH))
    judged = engine.map(_judge, grader, batches, threads=None)
    parts = []
    for name, rows in shards.items():
        if name in missing:
            answers = islice(judged, -(-(rows.stop - rows.start) // BATCH))
            save_weights(paths[name], {"opinions": torch.cat([*answers])})
        parts.append(read_tensors(paths[name], ["opinions"])["opinions"])
        if told is not None:
            told(len(parts[-1]))
    return torch.cat(parts).numpy()


def _judge(grader: Grader, images: Tensor) -> Tensor:
    """Return (B, 2) float32 views and grades, on the CPU, of a batch."""
    p, g = grader.probabilities_and_grade(images)
    return torch.stack([p.argmax(-1).float(), g.float()], 1).cpu()


def _bring(source: Path, linked: bool, target: Path) -> None:
    """Bring over a file that stays as it is; by a link where the old folder goes."""
    target.unlink(missing_ok=True)
    if linked:
        with suppress(OSError):  # another file system, or one without links
            os.link(source, target)
            return
    shutil.copyfile(source, target)


def _write_shard(source: Path, opinions: np.ndarray, path: Path) -> None:
    """Write a shard anew, row group by row group, with the opinions in it."""
    columns = {
        "view_predicted": pa.array(opinions[:, 0].astype(np.int64)),
        "grade_predicted": pa.array(opinions[:, 1], pa.float32()),
    }
    old, start = pq.ParquetFile(source), 0
    with pq.ParquetWriter(path, old.schema_arrow, compression="zstd") as writer:
        for group in range(old.num_row_groups):
            table = old.read_row_group(group)
            for name, column in columns.items():
                place = table.schema.get_field_index(name)
                rows = column.slice(start, len(table))
                table = table.set_column(place, table.schema.field(place), rows)
            writer.write_table(table, row_group_size=len(table))
            start += len(table)


def _seal(final: Path, manifest: dict[str, Any], shards: Iterable[str]) -> None:
    """Write card, Croissant and manifest of the new files."""
    (final / CARD).write_text(write_card(manifest), encoding="utf-8")
    for name in (*shards, CARD):
        path = final / name
        manifest["files"][name] = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    if CROISSANT in manifest["files"]:
        add_croissant(manifest, final)
    (final / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
