"""A dataset by trajectory: read for an exporter, written into a training store and a new folder."""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from racines_data.digest import checked_shards
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic, write_once
from racines_data.manifest import ADDED, MANIFEST, METADATA, STORES, read_manifest, store_name
from racines_data.records import (
    MASK_PIXELS,
    PIXELS,
    RAW_PIXELS,
    beats,
    decode_images,
    double_columns,
    float_columns,
    pixels_array,
)
from racines_data.schema import CONTROLS, PARAMETERS, PHASES, SPLITS, TURNS

_BATCH = 1024
_IDENTITY = ("trajectory", "session", "target_view")


@dataclass(frozen=True)
class Sweep:
    """One trajectory of T frames, and its split."""

    split: str
    table: pa.Table  # T rows of the `frames` config, in order

    def __len__(self) -> int:
        return len(self.table)

    def first(self, column: str) -> Any:
        """Return a column's value in the first row."""
        return self.table[column][0].as_py()

    @property
    def id(self) -> str:
        """Name of the trajectory."""
        return self.first("trajectory")

    def pngs(self, column: str = "image") -> list[bytes]:
        """Return the images, or the masks, as they are stored."""
        return self.table[column].combine_chunks().field("bytes").to_pylist()

    def images(self) -> np.ndarray:
        """Return (T, 128, 128) uint8."""
        return decode_images(self.table["image"])

    def masks(self) -> np.ndarray | None:
        """Return (T, 128, 128) uint8 labels; None where frames have no masks."""
        has = "mask" in self.table.column_names and not self.table["mask"].null_count
        return decode_images(self.table["mask"]) if has else None


def read_sweeps(
    root: Path, split: str | None = None, limit: int | None = None, config: str = "frames"
) -> Iterator[Sweep]:
    """Yield the trajectories of a dataset in its order, their files' digests checked first.

    At most `limit` frames are read: the last trajectory may be cut short.

    Raises:
        RacinesError: no such dataset, config or split, a damaged file, or a limit below one.
    """
    if limit is not None and limit < 1:
        raise RacinesError(f"limit {limit}: give one frame or more")
    for name, paths in checked_shards(root, read_manifest(root), config, split).items():
        for table in trajectories(root, paths):
            yield Sweep(name, table.slice(0, limit))
            if limit is not None:
                limit -= len(table)
                if limit <= 0:
                    return


def trajectories(root: Path, paths: Sequence[str]) -> Iterator[pa.Table]:
    """Yield one table a trajectory; it may begin in one file and go on in the next."""
    held: list[pa.Table] = []
    for path in paths:
        with pq.ParquetFile(root / path) as file:
            for batch in file.iter_batches(_BATCH):
                table = pa.Table.from_batches([batch])
                for start, stop in pairwise(run_edges(table["trajectory"].to_numpy())):
                    part = table.slice(start, stop - start)
                    if held and not part["trajectory"][0].equals(held[0]["trajectory"][0]):
                        yield pa.concat_tables(held).combine_chunks()
                        held = []
                    held.append(part)
    if held:
        yield pa.concat_tables(held).combine_chunks()


def run_edges(values: np.ndarray) -> list[int]:
    """Return where runs of equal values begin, and the length; of nothing, nothing."""
    if not len(values):
        return []
    return [0, *(np.flatnonzero(values[1:] != values[:-1]) + 1).tolist(), len(values)]


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a folder beside `out` to write in; it becomes `out` when the block ends without error.

    What a killed run has left there is written again, what an error left is removed; an `out` that
    exists is refused.
    """
    if out.exists():
        raise RacinesError(f"{out}: exists; name a new folder or remove it")
    aside = out.parent / f".{out.name}.part"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    try:
        yield aside
    except Exception:
        shutil.rmtree(aside, ignore_errors=True)
        raise
    os.replace(aside, out)


def write_store(
    path: Path, tables: Callable[[], Iterable[pa.Table]], trajectories: Sequence[Mapping[str, Any]]
) -> None:
    """Write the store from tables of one trajectory each, in row order.

    The file is first written with images of zeros, which take no memory, and the pixels are then
    put in their place one trajectory at a time: memory stays bounded however many frames.

    Args:
        path: The file to write.
        tables: Gives the rows of `frames` with their raw pixels, one table a trajectory.
        trajectories: Identity, `split` and `frames` of each, in the order of the splits; `patient`
            where one is scanned.
    """
    columns = [_store_columns(table, index) for index, table in enumerate(tables())]
    raw = {"image": RAW_PIXELS, "mask": MASK_PIXELS}
    raw = {name: each for name, each in raw.items() if each in next(iter(tables())).column_names}
    table = pa.concat_tables(columns).combine_chunks()
    zeros = pa.py_buffer(np.zeros(len(table) * PIXELS, np.uint8))
    images = pa.FixedSizeBinaryArray.from_buffers(pa.binary(PIXELS), len(table), [None, zeros])
    for place, name in enumerate(raw):
        table = table.add_column(place, name, images)
    table = table.replace_schema_metadata({METADATA: _metadata(trajectories).encode()})
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
        writer.write_batch(table.to_batches()[0])
    with path.open("r+b") as file:
        for name, own in raw.items():
            file.seek(_offset(path, name))
            for made in tables():
                for chunk in made[own].chunks:
                    first = chunk.offset * PIXELS
                    file.write(chunk.buffers()[1][first : first + len(chunk) * PIXELS])


def _metadata(trajectories: Sequence[Mapping[str, Any]]) -> str:
    """Return what a store says of its trajectories and splits, as JSON."""
    splits, start = {}, 0
    for split in SPLITS:
        stop = start + sum(row["frames"] for row in trajectories if row["split"] == split)
        splits[split], start = (start, stop), stop
    names = [[row[key] for row in trajectories] for key in _IDENTITY]
    phantoms = [row["phantom"] for row in trajectories]
    metadata = {"trajectories": names, "phantoms": phantoms, "splits": splits}
    if any("patient" in row for row in trajectories):
        metadata["patients"] = [row["patient"] for row in trajectories]
    return json.dumps(metadata, sort_keys=True)


def _offset(path: Path, column: str) -> int:
    """Return the byte of a store's file at which a column of images begins."""
    with pa.memory_map(str(path)) as mapped:
        whole = mapped.read_buffer()
        images = pa.ipc.open_file(pa.BufferReader(whole)).read_all()[column].chunk(0)
        return images.buffers()[1].address - whole.address


def _store_columns(table: pa.Table, index: int) -> pa.Table:
    def stacked(names: Sequence[str]) -> pa.Array:
        flat = pa.array(float_columns(table, names).ravel(), pa.float32())
        return pa.FixedSizeListArray.from_arrays(flat, len(names))

    phases, doubles = {}, {}
    if "patient" in table.column_names:
        doubles["phases"] = double_columns(table, PHASES)
    if TURNS[0] in table.column_names:
        doubles["turns"] = double_columns(table, TURNS)
        if (both := beats(table)) is not None:
            doubles["phases"] = both
    for name, both in doubles.items():
        phases[name] = pa.FixedSizeListArray.from_arrays(pa.array(both.ravel()), both.shape[1])
    return pa.table(
        {
            "parameters": stacked(PARAMETERS),
            "controls": stacked(CONTROLS),
            "view": table["view"].fill_null(-1).combine_chunks(),
            "grade": table["grade"].fill_null(np.nan).combine_chunks(),
            "timestamp": table["timestamp"].fill_null(np.nan).combine_chunks(),
            "trajectory": pa.array(np.full(len(table), index, np.int64)),
            "frame": table["frame"].cast(pa.int64()).combine_chunks(),
            **phases,
        }
    )


def restore_stores(root: Path) -> list[str]:
    """Make the training stores that a dataset names and lacks, from its shards; return their paths.

    Equal pixels and numbers; should another pyarrow lay the file out otherwise, the manifest here
    gets its sha256. A damaged shard, or a folder that cannot be written, is a `RacinesError`.
    """
    made = []
    for config in STORES:
        name = store_name(config)
        if name in read_manifest(root)["files"] and not (root / name).exists():
            try:
                write_once(root / name, lambda path, of=config: _restore(root, of, path))
            except OSError as error:
                raise RacinesError(f"{root / name}: cannot be written ({error})") from error
            made.append(name)
    return made


def _restore(root: Path, config: str, path: Path) -> None:
    more = ("phantom", "patient") if config in ADDED else ("phantom",)
    rows = [
        {key: sweep.first(key) for key in (*_IDENTITY, *more)}
        | {"split": sweep.split, "frames": len(sweep)}
        for sweep in read_sweeps(root, config=config)
    ]

    def tables() -> Iterable[pa.Table]:
        for sweep in read_sweeps(root, config=config):
            table = sweep.table.append_column(RAW_PIXELS, pixels_array(sweep.images()))
            masks = sweep.masks()
            yield table if masks is None else table.append_column(MASK_PIXELS, pixels_array(masks))

    write_store(path, tables, rows)
    manifest = read_manifest(root)
    record = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    if manifest["files"][store_name(config)] != record:
        manifest["files"][store_name(config)] = record
        write_atomic(root / MANIFEST, json.dumps(manifest, indent=1) + "\n")
