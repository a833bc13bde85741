"""Files between a dataset and a program outside: the poses it must draw, the images it drew.

Both are Parquet with one row for each sample and seed, and metadata that name dataset and frames.
The columns and keys are described in `docs/outside.md`. A predictions file is read as what a
stranger sent: checked whole, in batches, never trusted; its PNG images are looked at before they
are decoded, and decoded within bounds.
"""

import io
import json
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from PIL import Image
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import naming, sha256_file
from racines_data.imaging import IMAGE_SIZE, ImageSource
from racines_data.randomness import derive
from racines_data.records import encode_png
from racines_data.schema import PARAMETERS
from racines_data.sources.images import check_png
from racines_data.store.asked import AskedStore
from racines_data.store.frames import Batch, FrameStore
from racines_models.contract import ContractError, check_range, declared
from racines_models.exchange.naming import check_name, check_size
from racines_models.provenance import sha256_bytes
from racines_models.sample import DRAW, Progress, Sample, draw

POSES = "racines.poses/1"
PREDICTIONS = "racines.predictions/1"
KEYS = ("schema", "dataset", "recipe", "source", "version", "split", "sample", "generator", "text")
FLAGS = ("stochastic", "conditional")
"""Metadata keys of what is declared, `true` or `false`, with `racines.` before each."""
"""Metadata keys, each with `racines.` before it."""
MAX_TEXT = 10_000
GROUP = 256
"""Rows of a row group, which bounds what a reader holds at once."""

IDS = [pa.field("sample", pa.int64(), False), pa.field("seed", pa.int64(), False)]
NOISE_SEED = pa.field("noise_seed", pa.int64(), False)
PATIENT = pa.field("patient", pa.int64(), False)
POSE_COLUMNS = pa.schema([*IDS, NOISE_SEED, *(pa.field(name, pa.float32()) for name in PARAMETERS)])
PREDICTION_COLUMNS = pa.schema([*IDS, pa.field("image", pa.binary(), False)])

MAX_BYTES = 2**30
"""Largest file, and largest size of its columns once unpacked."""
MAX_ROWS = 1_000_000
BATCH = 64
"""Rows decoded at once."""
MAX_PNG = 2**16
"""Most bytes of one image; 128 × 128 gray levels without compression are 16.6 kB."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
MODES = {0: "gray", 2: "RGB", 3: "palette", 4: "gray with alpha", 6: "RGBA"}
REQUIRED = ("schema", "dataset", "split", "sample", "generator")


@dataclass(frozen=True)
class Task:
    """What is to be drawn: frames of one dataset, once for each seed."""

    store: FrameStore
    sample: Sample
    split: str
    seeds: tuple[int, ...]

    @property
    def asked(self) -> AskedStore | None:
        """The store, where the frames are what is asked of patients; else None."""
        return self.store if isinstance(self.store, AskedStore) else None

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

    `noise_seed` is a hash of seed and row: of one heart the seed that a generator of ours gets for
    the sample. Of poses asked of patients `patient` is whose each is.
    """
    frames, asked = task.sample.frames, task.asked
    schema = POSE_COLUMNS if asked is None else POSE_COLUMNS.insert(len(IDS), PATIENT)

    def columns(seed: int) -> list[Any]:
        noise = derive(torch.full_like(frames.index, seed), DRAW, frames.index)
        whose = [] if asked is None else [asked.units(frames.index)]
        return [*whose, noise.numpy(), *frames.parameters.numpy().T]

    return _write(path, schema, task.metadata(POSES), task, columns)


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
    told = asdict(declared(generator))
    metadata |= {key: json.dumps(told[key]) for key in FLAGS if told[key] is not None}

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
    index = task.sample.frames.index.numpy()
    with writing(path, schema, metadata) as writer:
        for seed in task.seeds:
            values = [index, np.full(len(index), seed), *columns(seed)]
            table = pa.table([pa.array(each) for each in values], schema=writer.schema)
            writer.write_table(table, row_group_size=GROUP)
    return len(index) * len(task.seeds)


@contextmanager
def writing(path: Path, schema: pa.Schema, metadata: dict[str, str]) -> Iterator[pq.ParquetWriter]:
    """Write a Parquet file with `racines.` metadata, which takes its place once it is whole."""
    schema = schema.with_metadata({f"racines.{key}": value for key, value in metadata.items()})
    aside = path.with_name(f".{path.name}.part")
    try:
        with naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with pq.ParquetWriter(aside, schema, compression="zstd", use_dictionary=False) as file:
                yield file
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


class Predictions:
    """Images drawn beforehand by a program outside, found by frame and seed.

    `racines_models.sample.draw` asks `draw_frames`; there is no `generate`, since a file draws no
    other pose than those it holds.

    The file must be made for the dataset of `store`, and for `split` unless that is None.

    Raises:
        RacinesError: not such a file, too large, or made for another dataset or split.
    """

    def __init__(self, path: Path, store: FrameStore, split: str | None = None):
        self.path = Path(path)
        check_size(self.path, MAX_BYTES)
        with self._opened() as file:
            self.metadata = _read_metadata(file.schema_arrow.metadata or {}, self.path)
            self._check_columns(file)
            self.rows: int = file.metadata.num_rows
        self.name = check_name(self.metadata["generator"], f"{self.path}: racines.generator")
        says = {"true": True, "false": False, None: None}
        self.stochastic, self.conditional = (says[self.metadata.get(key)] for key in FLAGS)
        """What the file declares: whether the seed, and whether the pose, changes the image."""
        self.sha256 = sha256_file(self.path)
        told = self.metadata
        check_made_for(self.path, store.manifest["digest"], told)
        if split not in (None, told["split"]):
            raise RacinesError(
                f"{self.path}: made for split {told['split'][:80]!r}, not {split!r}: "
                "give --split as in the file, or draw the poses of this split"
            )

    def draw_frames(self, frames: Batch, seed: int) -> Tensor:
        """Return (N, 128, 128) uint8: the image of each frame, drawn with the seed.

        Raises:
            RacinesError: the file was made for other frames; a sample is missing, stands twice or
                is none of the frames; an image is no 8-bit gray PNG of 128 × 128 pixels; or the
                images show nothing (see `check_drawn`).
        """
        index = frames.index.numpy()
        told, digest = self.metadata["sample"], sha256_bytes(index.tobytes())
        if told != digest:
            raise RacinesError(
                f"{self.path}: {self.rows} rows made for another sample of frames "
                f"({told[:12]!r}…, here {len(index)} frames {digest[:12]!r}…): "
                "give --samples as `racines export poses` had it, or draw these poses"
            )
        finder = _Finder(self.path, index, seed)
        images = torch.zeros(len(index), IMAGE_SIZE, IMAGE_SIZE, dtype=torch.uint8)
        for row, samples, seeds, pngs in self._batches():
            for i in np.flatnonzero(seeds == seed):
                place = finder.place(int(samples[i]), row + int(i))
                where = f"{self.path}, row {row + i}, sample {samples[i]}"
                images[place] = torch.from_numpy(decode_gray(pngs(int(i), where), where).copy())
        finder.check_complete()
        try:
            check_range(images)
        except ContractError as error:
            raise error.at(f"{self.path}, seed {seed}") from error
        return images

    def _opened(self, *dictionary: str) -> pq.ParquetFile:
        # Pages as they come: no column is read ahead, so memory holds one page and one batch.
        paged = {"memory_map": False, "buffer_size": 2**20, "pre_buffer": False}
        try:
            return pq.ParquetFile(self.path, read_dictionary=list(dictionary), **paged)
        except Exception as error:
            problem = f"not readable as Parquet: {error}; write it again"
            raise RacinesError(f"{self.path}: {problem}") from error

    def _check_columns(self, file: pq.ParquetFile) -> None:
        found = {field.name: field.type for field in file.schema_arrow}
        wanted = {field.name: field.type for field in PREDICTION_COLUMNS}
        if len(found) != len(file.schema_arrow) or set(found) != set(wanted):
            given = ", ".join(file.schema_arrow.names[:20])
            asked = ", ".join(PREDICTION_COLUMNS.names)
            raise RacinesError(f"{self.path}: columns {given}: give {asked} and no other")
        for name, kind in wanted.items():
            allowed = (kind, pa.large_binary()) if name == "image" else (kind,)
            if found[name] not in allowed:
                hint = "the bytes of an 8-bit gray PNG" if name == "image" else "whole numbers"
                raise RacinesError(f"{self.path}: {name} is {found[name]}: give {kind}, {hint}")
        told = file.metadata
        unpacked = sum(told.row_group(i).total_byte_size for i in range(told.num_row_groups))
        if told.num_rows > MAX_ROWS or unpacked > MAX_BYTES:
            given = f"{told.num_rows:,} rows, {unpacked:,} bytes unpacked"
            raise RacinesError(f"{self.path}: {given}: at most {MAX_ROWS:,} and {MAX_BYTES:,}")

    def _batches(self) -> Iterator[tuple[int, np.ndarray, np.ndarray, Any]]:
        """Yield the first row's number, samples, seeds, and a function from place to PNG bytes."""
        row = 0
        # One image of 1 GiB may stand in many rows of a small file. Held as a dictionary, it is
        # there once, and its size is looked at before it is taken out.
        with self._opened("image") as file:
            reader = file.iter_batches(BATCH, columns=PREDICTION_COLUMNS.names, use_threads=False)
            while True:
                try:
                    batch = next(reader, None)
                except Exception as error:
                    problem = f"damaged behind row {row}: {error}; write it again"
                    raise RacinesError(f"{self.path}: {problem}") from error
                if batch is None:
                    return
                columns = {name: batch[name] for name in PREDICTION_COLUMNS.names}
                for name, column in columns.items():
                    if column.null_count:
                        null = row + int(column.is_null().to_numpy(False).argmax())
                        raise RacinesError(f"{self.path}, row {null}: {name} is null: fill it in")
                samples, seeds = (columns[name].to_numpy() for name in ("sample", "seed"))
                yield row, samples, seeds, _png_of(columns["image"])
                row += len(batch)


def check_made_for(path: Path, digest: str, told: dict[str, str]) -> None:
    """Check that a file was made for the dataset of a digest, by its metadata."""
    if told["dataset"] != digest:
        raise RacinesError(
            f"{path}: made for dataset {told['dataset'][:80]!r}, this one is {digest!r}: "
            "draw the poses that `racines export poses` writes of this dataset"
        )


def metadata_of(path: Path) -> dict[str, str]:
    """Return what a predictions file says that it was made for, without its images.

    Raises:
        RacinesError: not such a file, or too large.
    """
    check_size(path, MAX_BYTES)
    try:
        return _read_metadata(pq.read_schema(path).metadata or {}, path)
    except (OSError, pa.ArrowException) as error:
        raise RacinesError(f"{path}: not readable as Parquet: {error}") from error


def _png_of(column: Any) -> Any:
    def png(place: int, where: str) -> bytes:
        buffer = column[place].value.as_buffer()
        if buffer.size > MAX_PNG:
            raise RacinesError(f"{where}: {buffer.size:,} bytes: a PNG has at most {MAX_PNG:,}")
        return buffer.to_pybytes()

    return png


class _Finder:
    """Where each sample's image belongs, and which have come."""

    def __init__(self, path: Path, index: np.ndarray, seed: int):
        self._path, self._seed = path, seed
        self._places = {sample: place for place, sample in enumerate(index.tolist())}
        self._rows: dict[int, int] = {}
        """Row of the file that held each sample."""

    def place(self, sample: int, row: int) -> int:
        """Return the place of a sample among the frames, once."""
        where = f"{self._path}, row {row}: sample {sample}, seed {self._seed}"
        if sample not in self._places:
            raise RacinesError(f"{where}: none of the frames to be drawn: remove the row")
        if sample in self._rows:
            raise RacinesError(f"{where}: stands in row {self._rows[sample]} too: keep one")
        self._rows[sample] = row
        return self._places[sample]

    def check_complete(self) -> None:
        """Refuse a file that lacks a sample."""
        missing, seed = [each for each in self._places if each not in self._rows], self._seed
        if len(missing) == len(self._places) > 0:
            none = f"no rows of seed {seed}"
            raise RacinesError(f"{self._path}: {none}: draw it, or set scores.seeds")
        if missing:
            raise RacinesError(
                f"{self._path}: {len(missing)} of {len(self._places)} samples of seed {seed} are "
                f"missing, the first {missing[0]}: add their rows"
            )


def _read_metadata(raw: dict[bytes, bytes], path: Path) -> dict[str, str]:
    told: dict[str, str] = {}
    for key, value in raw.items():
        if not key.startswith(b"racines."):
            continue
        name = key.decode(errors="replace").removeprefix("racines.")
        where = f"{path}: metadata racines.{name[:80]}"
        if name not in (*KEYS, *FLAGS):
            raise RacinesError(f"{where}: unknown; known: {', '.join((*KEYS, *FLAGS))}")
        if name in FLAGS and value not in (b"true", b"false"):
            raise RacinesError(f"{where}: {value[:80]!r}: give true or false")
        if len(value) > MAX_TEXT:
            raise RacinesError(f"{where}: over {MAX_TEXT:,} bytes")
        try:
            told[name] = value.decode()
        except UnicodeDecodeError as error:
            raise RacinesError(f"{where}: not UTF-8: {error}") from error
    missing = [f"racines.{key}" for key in REQUIRED if key not in told]
    remedy = f"set racines.schema to {PREDICTIONS} and racines.generator to a name"
    if told.get("schema") == POSES:
        raise RacinesError(f"{path}: its metadata are those of a poses file: {remedy}")
    if missing:
        lack = f"metadata lack {', '.join(missing)}"
        raise RacinesError(f"{path}: {lack}: carry over those of the poses file, and {remedy}")
    if told["schema"] != PREDICTIONS:
        raise RacinesError(f"{path}: racines.schema is {told['schema'][:80]!r}, not {PREDICTIONS}")
    return told


def decode_gray(data: bytes, where: str) -> np.ndarray:
    """Return the (128, 128) uint8 gray levels of an 8-bit gray PNG; refuse all else, by `where`."""
    if len(data) > MAX_PNG:
        raise RacinesError(f"{where}: {len(data):,} bytes: a PNG has at most {MAX_PNG:,}")
    if len(data) < 33 or data[:8] != SIGNATURE or data[12:16] != b"IHDR":
        raise RacinesError(f"{where}: not a PNG: give the bytes of an 8-bit gray PNG")
    width, height, bits, color = struct.unpack(">IIBB", data[16:26])
    if (width, height) != (IMAGE_SIZE, IMAGE_SIZE):
        raise RacinesError(f"{where}: {width} x {height} pixels: give {IMAGE_SIZE} x {IMAGE_SIZE}")
    if (bits, color) != (8, 0):
        mode = MODES.get(color, f"colour type {color}")
        raise RacinesError(f"{where}: {bits}-bit {mode}: give 8-bit gray (mode L)")
    try:
        check_png(data)
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            # A second header further on could change what the first one said.
            if image.size != (IMAGE_SIZE, IMAGE_SIZE) or image.mode != "L":
                raise RacinesError(f"damaged PNG: it says {image.size} behind its header")
            return np.asarray(image)
    except Exception as error:
        raise RacinesError(f"{where}: {error}: write the image again") from error
