"""Reading a dataset's trajectories for an exporter; writing a new folder whole or not at all."""

import io
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from racines_data.digest import checked_shards
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest

_BATCH = 1024


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

    def pngs(self) -> list[bytes]:
        """Return the images as they are stored."""
        return self.table["image"].combine_chunks().field("bytes").to_pylist()

    def images(self) -> np.ndarray:
        """Return (T, 128, 128) uint8."""
        return np.stack([np.asarray(Image.open(io.BytesIO(png))) for png in self.pngs()])


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
    wanted = checked_shards(root, read_manifest(root), config, split)
    for name, paths in wanted.items():
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

    What a killed run has left there is written again; an `out` that exists is refused.
    """
    if out.exists():
        raise RacinesError(f"{out}: exists; name a new folder or remove it")
    aside = out.parent / f".{out.name}.part"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    yield aside
    os.replace(aside, out)
