"""Files between a dataset and a program outside: the poses it must draw, the images it drew.

Both are Parquet with one row for each sample and seed, and metadata that name dataset and frames.
The columns and keys are described in `docs/outside.md`.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.randomness import derive
from racines_data.records import encode_png
from racines_data.schema import PARAMETERS
from racines_data.store.frames import FrameStore
from racines_models.exchange.naming import check_name
from racines_models.sample import DRAW, Progress, Sample, draw

POSES = "racines.poses/1"
PREDICTIONS = "racines.predictions/1"
KEYS = ("schema", "dataset", "recipe", "source", "version", "split", "sample", "generator", "text")
"""Metadata keys, each with `racines.` before it."""
MAX_TEXT = 10_000
GROUP = 256
"""Rows of a row group, which bounds what a reader holds at once."""

IDS = [pa.field("sample", pa.int64(), False), pa.field("seed", pa.int64(), False)]
NOISE_SEED = pa.field("noise_seed", pa.int64(), False)
POSE_COLUMNS = pa.schema([*IDS, NOISE_SEED, *(pa.field(name, pa.float32()) for name in PARAMETERS)])
PREDICTION_COLUMNS = pa.schema([*IDS, pa.field("image", pa.binary(), False)])


@dataclass(frozen=True)
class Task:
    """What is to be drawn: frames of one dataset, once for each seed."""

    store: FrameStore
    sample: Sample
    split: str
    seeds: tuple[int, ...]

    def metadata(self, schema: str) -> dict[str, str]:
        """Return what names dataset and frames in a file's metadata."""
        manifest = self.store.manifest
        return {
            "schema": schema,
            "dataset": manifest["digest"],
            "recipe": manifest.get("recipe_digest") or "",
            "source": manifest.get("source") or "",
            "version": manifest.get("version") or "",
            "split": self.split,
            "sample": self.sample.digest,
        }


def write_poses(path: Path, task: Task) -> int:
    """Write the poses that an outside program draws; return the number of rows.

    `noise_seed` is the seed that a generator of ours gets for the sample: a hash of seed and row.
    """
    frames = task.sample.frames

    def columns(seed: int) -> list[Any]:
        noise = derive(torch.full_like(frames.index, seed), DRAW, frames.index)
        return [noise.numpy(), *frames.parameters.numpy().T]

    return _write(path, POSE_COLUMNS, task.metadata(POSES), task, columns)


def write_predictions(
    path: Path,
    task: Task,
    generator: ImageSource,
    name: str,
    text: str = "",
    progress: Progress | None = None,
) -> int:
    """Draw a task with a generator and write its images; return the number of rows.

    Raises:
        RacinesError: images that cannot be scored, or a name or text that is refused.
    """
    metadata = task.metadata(PREDICTIONS) | {"generator": check_name(name, "generator")}
    if len(text) > MAX_TEXT:
        raise RacinesError(f"text: {len(text):,} characters: give at most {MAX_TEXT:,}")
    if text:
        metadata["text"] = text

    def columns(seed: int) -> list[Any]:
        images = draw(generator, task.sample.frames, seed, progress).numpy()
        return [[encode_png(image) for image in images]]

    return _write(path, PREDICTION_COLUMNS, metadata, task, columns)


def _write(
    path: Path,
    schema: pa.Schema,
    metadata: dict[str, str],
    task: Task,
    columns: Callable[[int], list[Any]],
) -> int:
    """Write the rows of each seed, with the `columns` behind sample and seed."""
    schema = schema.with_metadata({f"racines.{key}": value for key, value in metadata.items()})
    index = task.sample.frames.index.numpy()
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.part")
    try:
        with pq.ParquetWriter(aside, schema, compression="zstd", use_dictionary=False) as writer:
            for seed in task.seeds:
                values = [index, np.full(len(index), seed), *columns(seed)]
                table = pa.table([pa.array(each) for each in values], schema=schema)
                writer.write_table(table, row_group_size=GROUP)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    return len(index) * len(task.seeds)
