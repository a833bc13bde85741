"""Real echo from files: A4C frames, masks that cardiologists drew, other views, posed rotations.

FILE.parquet   a row a frame: `patient`, `image` (128 x 128 PNG, apex at the top, padded to a
               square), where known `phase` (ED, ES), `view`, and `width` and `height` before
masks.parquet  a row a frame: `patient`, `phase`, `mask` (128 x 128 PNG: 1 LV, 2 myocardium,
               3 LA), `mm_per_row`, `mm_per_column`
FOLDER         any of these files, and folders of
               a rotation: `transforms_train.json` and `images/*.png`, as NeuralCMF has them
               single pictures: the name tells the view (`08_a4ch-full.png`, `26_plax.png`)
"""

import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
import torch
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.imaging import IMAGE_SIZE
from racines_models.studies.sim_to_real.sectors import (
    are_stretched,
    crop_screen,
    laid_out,
    unstretched,
)

VIEW = "A4C"
POSES = "transforms_train.json"
WORDS = {"a4ch": VIEW, "a4c": VIEW, "plax": "PL", "psax": "PSAX", "subcostal": "SC"}
"""What the name of a picture says of its view."""


class Frames(NamedTuple):
    """Real A4C frames."""

    images: Tensor
    """(N, 128, 128) uint8."""
    patient: np.ndarray
    """(N,) str."""
    phase: np.ndarray
    """(N,) str: `ED`, `ES`, or empty."""
    aspect: np.ndarray
    """(N,) height by width before the frame was padded, NaN where unknown."""
    sha256: str


class Drawn(NamedTuple):
    """Masks that cardiologists drew on some of the frames."""

    masks: Tensor
    """(M, 128, 128) uint8, CAMUS's numbers."""
    row: np.ndarray
    """(M,) the frame that each was drawn on."""
    mm: np.ndarray
    """(M, 2) millimetres a row and a column."""
    stretched: bool
    """Whether the file has them stretched to the square, which is undone here."""
    sha256: str


class Rotation(NamedTuple):
    """A probe turned about the apex of one heart."""

    images: Tensor
    """(N, 128, 128) uint8."""
    angle: np.ndarray
    """(N,) degrees in (-180, 180] from the turn that shows A4C."""
    turn: np.ndarray
    """(N,) number of the turn, whose frames share a pose."""


class Pictures(NamedTuple):
    """Single pictures, cut out of the scanner's screen."""

    images: Tensor
    """(N, 128, 128) uint8."""
    views: tuple[str, ...]
    names: tuple[str, ...]


class RealEcho(NamedTuple):
    """What was found; None where there is none."""

    frames: Frames
    drawn: Drawn | None = None
    rotation: Rotation | None = None
    pictures: Pictures | None = None


def read_real_echo(path: Path, masks: Path | None = None) -> RealEcho:
    """Read a Parquet file of frames, or all that a folder has.

    Raises:
        RacinesError: absent, of other columns, or damaged; by file and field, with the remedy.
    """
    if path.is_file():
        frames = read_frames(path)
        return RealEcho(frames, read_masks(masks, frames) if masks else None)
    if not path.is_dir():
        raise RacinesError(f"{path}: no such file or folder; see docs/sim-to-real.md")
    found = {name: _one(path, name) for name in ("image", "mask")}
    if found["image"] is None:
        told = "no Parquet file with columns patient and image"
        raise RacinesError(f"{path}: {told}; name the file of A4C frames (docs/sim-to-real.md)")
    frames, masks = read_frames(found["image"]), masks or found["mask"]
    folders = sorted(each for each in path.iterdir() if each.is_dir())
    turned = [read_rotation(each) for each in folders if (each / POSES).is_file()]
    shown = [each for each in map(read_pictures, folders) if each is not None]
    return RealEcho(
        frames,
        read_masks(masks, frames) if masks else None,
        turned[0] if turned else None,
        shown[0] if shown else None,
    )


def _one(folder: Path, column: str) -> Path | None:
    """Return the one Parquet file of a folder that has a column beside `patient`."""
    found = []
    for path in sorted(folder.glob("*.parquet")):
        names = pl.read_parquet_schema(path)
        if column in names and "patient" in names:
            found.append(path)
    if len(found) > 1:
        files = ", ".join(each.name for each in found)
        raise RacinesError(f"{folder}: column {column} is in {files}; name one of them instead")
    return found[0] if found else None


def read_frames(path: Path) -> Frames:
    """Read the A4C frames of a Parquet file."""
    table = _table(path, ("patient", "image"), "frames")
    if "view" in table.columns:
        table = table.filter(pl.col("view") == VIEW)
    if not len(table):
        raise RacinesError(f"{path}: column view never says {VIEW}; name a file that has such rows")
    images = torch.from_numpy(np.stack([_decode(each, path, "image") for each in table["image"]]))
    none = pl.Series([""] * len(table))
    phase = (table["phase"] if "phase" in table.columns else none).fill_null("").to_numpy()
    patient, aspect = table["patient"].cast(pl.String).to_numpy(), np.full(len(table), np.nan)
    if {"width", "height"} <= set(table.columns):
        aspect = (table["height"] / table["width"]).to_numpy()
    return Frames(images, patient, phase.astype(str), aspect, sha256_file(path))


def read_masks(path: Path, frames: Frames) -> Drawn:
    """Read the masks of those frames that have one, and lay them out as the frames are."""
    columns = ("patient", "phase", "mask", "mm_per_row", "mm_per_column")
    table = _table(path, columns, "masks")
    keys = zip(frames.patient.tolist(), frames.phase.tolist(), strict=True)
    row_of = {key: row for row, key in enumerate(keys)}
    table = table.with_columns(pl.col("patient").cast(pl.String))
    named = zip(table["patient"].to_list(), table["phase"].to_list(), strict=True)
    rows = np.array([row_of.get(key, -1) for key in named])
    if not (rows >= 0).any():
        told = "no patient and phase of it is among the frames"
        raise RacinesError(f"{path}: {told}; name the masks of these frames with --masks")
    table, rows = table.filter(pl.Series(rows >= 0)), rows[rows >= 0]
    masks = torch.from_numpy(np.stack([_decode(each, path, "mask") for each in table["mask"]]))
    if int(masks.max()) > 3:
        raise RacinesError(f"{path}: column mask has {int(masks.max())}; it holds 0-3 (CAMUS)")
    mm = table.select("mm_per_row", "mm_per_column").to_numpy()
    if not (mm > 0).all():
        raise RacinesError(f"{path}: mm_per_row or mm_per_column is not positive; give millimetres")
    stretched = are_stretched(masks, frames.aspect[rows])
    if stretched:
        masks = unstretched(masks, frames.aspect[rows])
    return Drawn(masks, rows, mm, stretched, sha256_file(path))


def _table(path: Path, columns: tuple[str, ...], what: str) -> pl.DataFrame:
    if not path.is_file():
        raise RacinesError(f"{path}: no such file; name a Parquet file of {what}")
    try:
        table = pl.read_parquet(path)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RacinesError(f"{path}: no Parquet file ({error}); name one of {what}") from error
    absent = [name for name in columns if name not in table.columns]
    if absent or not len(table):
        told = f"lacks column {', '.join(absent)}" if absent else "has no rows"
        raise RacinesError(f"{path}: {told}; {what} have {', '.join(columns)}")
    return table


def _decode(png: bytes, path: Path, column: str) -> np.ndarray:
    try:
        array = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
    except (UnidentifiedImageError, OSError, TypeError) as error:
        raise RacinesError(f"{path}: column {column} holds no PNG: {error}") from error
    if array.shape != (IMAGE_SIZE, IMAGE_SIZE):
        size = f"{array.shape[1]} x {array.shape[0]}"
        raise RacinesError(
            f"{path}: column {column} is {size}; make it {IMAGE_SIZE} x {IMAGE_SIZE}"
        )
    return array


def read_rotation(folder: Path) -> Rotation:
    """Read a rotation about the apex as NeuralCMF (Shen et al., IEEE TMI 2024) publishes one.

    The first column of a pose is the image's horizontal axis; the depth axis is the cube's third.
    The authors' zero of the turn shows A4C.
    """
    path = folder / POSES
    try:
        poses = np.array(
            [
                each["transform_matrix"]
                for each in json.loads(path.read_text(encoding="utf-8"))["frames"]
            ]
        )
    except (ValueError, KeyError, TypeError) as error:
        raise RacinesError(f"{path}: no frames with transform_matrix ({error})") from error
    files = sorted((folder / "images").glob("*.png"))
    if poses.shape != (len(files), 3, 4):
        told = f"{len(files)} pictures in images/, poses of shape {poses.shape}"
        raise RacinesError(f"{path}: {told}; give a 3 x 4 matrix for each picture")
    images = np.stack([laid_out(np.asarray(Image.open(each).convert("L"))) for each in files])
    turn = np.cumsum(np.r_[False, (np.diff(poses, axis=0) != 0).any((1, 2))])
    angle = np.degrees(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    return Rotation(torch.from_numpy(images), angle, turn)


def read_pictures(folder: Path) -> Pictures | None:
    """Read the pictures of a folder whose names tell a view; None where no name does."""
    found: list[Any] = []
    for path in sorted(folder.glob("*.png")):
        view = next((view for word, view in WORDS.items() if word in path.stem.lower()), None)
        if view is not None:
            found.append((crop_screen(Image.open(path)), view, path.name))
    if not found:
        return None
    images, views, names = zip(*found, strict=True)
    return Pictures(torch.from_numpy(np.stack(images)), views, names)
