"""Between a trajectory and the rows of the `frames` config: PNG, nulls for what is absent."""

import io
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from PIL import Image

from racines_data.files import image_bytes
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import ADDED
from racines_data.schema import (
    CONTROLS,
    PARAMETERS,
    PHASES,
    SOURCES,
    TURNS,
    Trajectory,
    frame_features,
)
from racines_data.sources.gate.check import check_trajectory as check_trajectory
from racines_data.views import LABELS

if TYPE_CHECKING:
    from datasets import Features

PIXELS = IMAGE_SIZE * IMAGE_SIZE
RAW_PIXELS, MASK_PIXELS = "pixels", "mask_pixels"
"""Columns of images and masks as they are in memory, while a dataset is made."""


def features_of(source: str, labels: Sequence[str] = LABELS, turned: bool = False) -> "Features":
    """Return the features of `frames` for one source, a third party's included, and its labels.

    `turned` frames are those of a rotation about the apex.
    """
    if source in ADDED:
        return frame_features((*SOURCES, *ADDED), labels, patients=True)
    sources = SOURCES if source in SOURCES else (*SOURCES, source)
    return frame_features(sources, labels, turned=turned)


def encode_png(image: np.ndarray) -> bytes:
    """Return one (H, W) uint8 image as PNG.

    Of the filtered rows of speckle, runs are all that a search for repeats would find: as small
    within 1 %, in two thirds of the time.
    """
    return image_bytes(Image.fromarray(image), compress_type=zlib.Z_RLE)


def trajectory_to_table(
    trajectory: Trajectory, source: str, labels: Sequence[str] = LABELS
) -> pa.Table:
    """Return a trajectory as rows of the `frames` config, with the Hugging Face metadata."""
    count = len(trajectory)
    features = features_of(source, labels, trajectory.turns is not None)
    floats = dict(zip(PARAMETERS, trajectory.parameters.T, strict=True))
    floats |= zip(CONTROLS, trajectory.controls.T, strict=True)
    floats["grade"] = trajectory.grades
    columns: dict[str, pa.Array] = {
        name: pa.array(values, pa.float32(), from_pandas=True) for name, values in floats.items()
    }
    columns["image"] = _png_column(trajectory.images, trajectory.id)
    columns["timestamp"] = pa.array(trajectory.timestamps, pa.float64(), from_pandas=True)
    columns["view"] = pa.array(trajectory.views, pa.int64(), mask=trajectory.views < 0)
    # What a grader makes of the frames is filled in later, by `racines data annotate`.
    columns["view_predicted"] = pa.nulls(count, pa.int64())
    columns["grade_predicted"] = pa.nulls(count, pa.float32())
    columns["target_view"] = pa.repeat(trajectory.target_view, count)
    columns["phantom"] = pa.array([trajectory.phantom] * count, pa.int32())
    columns["source"] = pa.repeat(pa.scalar(features["source"].str2int(source), pa.int64()), count)
    columns["session"] = pa.repeat(trajectory.session, count)
    columns["trajectory"] = pa.repeat(trajectory.id, count)
    columns["frame"] = pa.array(np.arange(count), pa.int32())
    if "patient" in features:
        columns |= _patient_columns(trajectory)
    if trajectory.turns is not None:
        phases = trajectory.phases
        beat = np.full(count, np.nan) if phases is None else phases[:, 0]
        named = zip((PHASES[0], *TURNS), (beat, *trajectory.turns.T), strict=True)
        columns |= {name: pa.array(each, pa.float64(), from_pandas=True) for name, each in named}
    return pa.table([columns[name] for name in features], schema=features.arrow_schema)


def _png_column(images: np.ndarray, name: str) -> pa.StructArray:
    names = [f"{name}-{frame:05d}.png" for frame in range(len(images))]
    pngs = pa.array([encode_png(image) for image in images], pa.binary())
    return pa.StructArray.from_arrays([pngs, pa.array(names)], ["bytes", "path"])


def _patient_columns(trajectory: Trajectory) -> dict[str, pa.Array]:
    """Return what the frames of a patient have besides the columns of `frames`."""
    count, phases, masks = len(trajectory), trajectory.phases, trajectory.masks
    columns = {"patient": pa.array([trajectory.patient] * count, pa.int64())}
    for index, name in enumerate(PHASES):
        known = phases is not None
        columns[name] = pa.array(phases[:, index]) if known else pa.nulls(count, pa.float64())
    kind = pa.struct({"bytes": pa.binary(), "path": pa.string()})
    named = f"{trajectory.id}-mask"
    columns["mask"] = pa.nulls(count, kind) if masks is None else _png_column(masks, named)
    return columns


def pixels_array(images: np.ndarray) -> pa.FixedSizeBinaryArray:
    """Return (T, 128, 128) uint8 images as an Arrow array of 16,384-byte values."""
    buffer = pa.py_buffer(np.ascontiguousarray(images))
    kind = pa.binary(PIXELS)
    return pa.FixedSizeBinaryArray.from_buffers(kind, len(images), [None, buffer])


def table_to_trajectory(table: pa.Table) -> Trajectory:
    """Return the trajectory that some rows of the `frames` config hold, in order."""
    return Trajectory(
        id=table["trajectory"][0].as_py(),
        session=table["session"][0].as_py(),
        target_view=table["target_view"][0].as_py(),
        images=decode_images(table["image"]),
        parameters=float_columns(table, PARAMETERS),
        timestamps=table["timestamp"].fill_null(np.nan).to_numpy(),
        controls=float_columns(table, CONTROLS),
        views=table["view"].fill_null(-1).to_numpy(),
        grades=float_columns(table, ["grade"])[:, 0],
        phantom=table["phantom"][0].as_py(),
        **(_of_patient(table) if "patient" in table.column_names else {}),
        **(_of_turns(table) if TURNS[0] in table.column_names else {}),
    )


def decode_images(column: pa.ChunkedArray) -> np.ndarray:
    """Return (T, 128, 128) uint8 of a column of PNG."""
    pngs = column.combine_chunks().field("bytes")
    return np.stack([np.asarray(Image.open(io.BytesIO(png.as_buffer()))) for png in pngs])


def _of_patient(table: pa.Table) -> dict[str, Any]:
    phases = np.stack([table[name].to_numpy() for name in PHASES], -1)
    return {
        "patient": table["patient"][0].as_py(),
        "phases": None if np.isnan(phases).all() else phases,
        "masks": None if table["mask"].null_count else decode_images(table["mask"]),
    }


def _of_turns(table: pa.Table) -> dict[str, Any]:
    return {"turns": double_columns(table, TURNS), "phases": beats(table)}


def beats(table: pa.Table) -> np.ndarray | None:
    """Return (T, 2) phases of a rotation's rows, the second NaN; None where there are none."""
    phases = np.stack([double_columns(table, PHASES[:1])[:, 0], np.full(len(table), np.nan)], -1)
    return None if np.isnan(phases[:, 0]).all() else phases


def double_columns(table: pa.Table, names: Sequence[str]) -> np.ndarray:
    """Return (T, len(names)) float64, NaN for null."""
    return np.stack([table[name].fill_null(np.nan).to_numpy() for name in names], -1)


def float_columns(table: pa.Table, names: Sequence[str]) -> np.ndarray:
    """Return (T, len(names)) float32, NaN for null."""
    return np.stack([table[name].fill_null(np.nan).to_numpy() for name in names], -1)
