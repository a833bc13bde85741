"""Writing the training store: one Arrow IPC file whose images are one contiguous run of bytes."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from racines_data.manifest import METADATA
from racines_data.records import PIXELS
from racines_data.schema import CONTROLS, PARAMETERS


def write_store(
    path: Path,
    tables: Callable[[], Iterable[pa.Table]],
    trajectories: Sequence[Mapping[str, Any]],
    splits: Mapping[str, tuple[int, int]],
) -> None:
    """Write the store from tables of one trajectory each, in row order.

    The file is first written with images of zeros, which take no memory, and the pixels are then
    put in their place one trajectory at a time: memory stays bounded however many frames.

    Args:
        path: The file to write.
        tables: Gives the rows of `frames` with a `pixels` column, one table a trajectory.
        trajectories: `trajectory`, `session`, `target_view` and `phantom` of each.
        splits: First and past-the-last row of each split.
    """
    columns = [_store_columns(table, index) for index, table in enumerate(tables())]
    table = pa.concat_tables(columns).combine_chunks()
    zeros = pa.py_buffer(np.zeros(len(table) * PIXELS, np.uint8))
    images = pa.FixedSizeBinaryArray.from_buffers(pa.binary(PIXELS), len(table), [None, zeros])
    keys = ("trajectory", "session", "target_view")
    names = [[row[key] for row in trajectories] for key in keys]
    phantoms = [row["phantom"] for row in trajectories]
    metadata = {"trajectories": names, "phantoms": phantoms, "splits": splits}
    table = table.add_column(0, "image", images).replace_schema_metadata(
        {METADATA: json.dumps(metadata, sort_keys=True).encode()}
    )
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
        writer.write_batch(table.to_batches()[0])
    with path.open("r+b") as file:
        file.seek(_image_offset(path))
        for made in tables():
            for chunk in made["pixels"].chunks:
                first = chunk.offset * PIXELS
                file.write(chunk.buffers()[1][first : first + len(chunk) * PIXELS])


def _image_offset(path: Path) -> int:
    with pa.memory_map(str(path)) as mapped:
        whole = mapped.read_buffer()
        images = pa.ipc.open_file(pa.BufferReader(whole)).read_all()["image"].chunk(0)
        return images.buffers()[1].address - whole.address


def _store_columns(table: pa.Table, index: int) -> pa.Table:
    def stacked(names: Sequence[str]) -> pa.Array:
        flat = np.stack([table[name].fill_null(np.nan).to_numpy() for name in names], -1).ravel()
        return pa.FixedSizeListArray.from_arrays(pa.array(flat, pa.float32()), len(names))

    return pa.table(
        {
            "parameters": stacked(PARAMETERS),
            "controls": stacked(CONTROLS),
            "view": table["view"].fill_null(-1).combine_chunks(),
            "grade": table["grade"].fill_null(np.nan).combine_chunks(),
            "timestamp": table["timestamp"].fill_null(np.nan).combine_chunks(),
            "trajectory": pa.array(np.full(len(table), index, np.int64)),
            "frame": table["frame"].cast(pa.int64()).combine_chunks(),
        }
    )
