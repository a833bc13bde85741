"""Motions in a file: what a program outside estimated of a dataset's sweeps, NPZ or Parquet.

An NPZ holds arrays, by name:

    schema, name, dataset, split      text: `racines.motion/1`, who estimated, the content digest
                                      of the dataset's config, and the split
    SWEEP/to_first                    (T, 4, 4) float64, m
    SWEEP/to_previous                 (T, 4, 4) float64, m

A Parquet has a row a frame: `sweep` (string), `frame` (int32, from 0), `to_first` and
`to_previous` (16 float64 each, row by row), and the four texts in its metadata, each with
`racines.` before its name. Transforms are as `motion.Motion` has them, about the probe; those of
frame 0 are the identity. A file is what a stranger sent: nothing in it is run, and all is checked.
"""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic
from racines_models.exchange.naming import check_name, check_size
from racines_models.trackerless.motion import Motion
from racines_models.trackerless.sweeps import Sweep

SCHEMA = "racines.motion/1"
TEXTS = ("schema", "name", "dataset", "split")
KINDS = ("to_first", "to_previous")
MAX_BYTES = 2**28
"""Largest file, and largest size of what it unpacks to."""
MAX_TEXT = 1_000
RIGID = 1e-3
"""Largest error of R Rᵀ - 1, per element."""
FARTHEST = 2.0
"""m; no hand moves a probe farther in one sweep."""
_CELL = pa.list_(pa.float64(), 16)
COLUMNS = pa.schema(
    [
        pa.field("sweep", pa.string(), False),
        pa.field("frame", pa.int32(), False),
        *(pa.field(kind, _CELL, False) for kind in KINDS),
    ]
)


@dataclass(frozen=True)
class Submission:
    """Motions of sweeps, by the sweeps' ids."""

    name: str
    dataset: str
    split: str
    motions: Mapping[str, Motion]
    sha256: str = ""
    """Of the file that it was read from."""

    def check(self, where: Path | str, sweeps: list[Sweep], dataset: str, split: str) -> None:
        """Refuse what was estimated of another dataset or split, or not of all its sweeps.

        Raises:
            RacinesError: which of them, or a sweep that is missing, unknown or of another length.
        """
        if self.dataset != dataset:
            told = f"dataset: made for {self.dataset[:64]!r}, this one is {dataset!r}"
            raise RacinesError(f"{where}: {told}: estimate the sweeps of this dataset")
        if self.split != split:
            told = f"split: made for {self.split[:64]!r}, not {split!r}"
            raise RacinesError(f"{where}: {told}: give --split as in the file")
        frames = {each.id: len(each) for each in sweeps}
        for sweep in self.motions:
            if sweep not in frames:
                told = f"sweep {sweep[:64]!r}: none of split {split}"
                raise RacinesError(f"{where}: {told}: leave it out")
        for sweep, count in frames.items():
            if sweep not in self.motions:
                raise RacinesError(f"{where}: sweep {sweep}: missing: estimate every sweep")
            given = len(self.motions[sweep].to_first)
            if given != count:
                told = f"{given} frames, the sweep has {count}"
                raise RacinesError(
                    f"{where}: sweep {sweep}: {told}: give every frame its transform"
                )


def write_submission(path: Path, submission: Submission) -> str:
    """Write a submission as NPZ or Parquet, by the file's ending; return its sha256.

    Raises:
        RacinesError: another ending, or transforms that would be refused.
    """
    path = Path(path)
    texts = {"schema": SCHEMA, **{key: getattr(submission, key) for key in TEXTS[1:]}}
    check_name(submission.name, "name")
    for sweep, motion in submission.motions.items():
        _check_motion(motion, f"{path}: sweep {sweep}")
    ending = path.suffix.lower()
    if ending not in (".npz", ".parquet"):
        raise RacinesError(f"{path}: end the name with .npz or .parquet")
    made = _npz(texts, submission) if ending == ".npz" else _parquet(texts, submission)
    write_atomic(path, made)
    return sha256_file(path)


def _npz(texts: dict[str, str], submission: Submission) -> bytes:
    out = io.BytesIO()
    arrays: dict[str, Any] = {key: np.array(text) for key, text in texts.items()}
    for sweep, motion in submission.motions.items():
        for kind in KINDS:
            arrays[f"{sweep}/{kind}"] = getattr(motion, kind).numpy()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def _parquet(texts: dict[str, str], submission: Submission) -> bytes:
    sweeps = [np.full(len(each.to_first), sweep) for sweep, each in submission.motions.items()]
    frames = [np.arange(len(each)) for each in sweeps]
    columns: list[Any] = [
        pa.array(np.concatenate(sweeps), pa.string()),
        pa.array(np.concatenate(frames), pa.int32()),
    ]
    for kind in KINDS:
        flat = torch.cat([getattr(each, kind) for each in submission.motions.values()]).flatten()
        columns.append(pa.FixedSizeListArray.from_arrays(pa.array(flat.numpy()), type=_CELL))
    schema = COLUMNS.with_metadata({f"racines.{key}": text for key, text in texts.items()})
    out = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), out, compression="zstd")
    return out.getvalue()


def read_submission(path: Path) -> Submission:
    """Read a file and check all that can be told without the dataset.

    Raises:
        RacinesError: which field is wrong, and what to do about it.
    """
    path = Path(path)
    check_size(path, MAX_BYTES)
    texts, arrays = _read_npz(path) if path.suffix.lower() == ".npz" else _read_parquet(path)
    for key in TEXTS:
        if key not in texts:
            raise RacinesError(f"{path}: {key}: missing: name it ({', '.join(TEXTS)})")
        if len(texts[key]) > MAX_TEXT:
            raise RacinesError(f"{path}: {key}: over {MAX_TEXT:,} characters: shorten it")
    if texts["schema"] != SCHEMA:
        raise RacinesError(f"{path}: schema: {texts['schema'][:64]!r}: expected {SCHEMA!r}")
    check_name(texts["name"], f"{path}: name")
    if not arrays:
        raise RacinesError(f"{path}: holds no sweep: give SWEEP/to_first and SWEEP/to_previous")
    motions = {}
    for sweep, pair in arrays.items():
        where = f"{path}: sweep {sweep[:64]}"
        for kind in KINDS:
            if kind not in pair:
                raise RacinesError(f"{where}: {kind}: missing: give both transforms")
        motions[sweep] = Motion(*(_transforms(pair[kind], f"{where}: {kind}") for kind in KINDS))
        _check_motion(motions[sweep], where)
    told = texts["name"], texts["dataset"], texts["split"]
    return Submission(*told, motions, sha256_file(path))


Arrays = dict[str, dict[str, np.ndarray]]
"""Transforms by sweep and kind."""
_NOT_NPZ = zipfile.BadZipFile, ValueError, EOFError, KeyError, NotImplementedError, MemoryError


def _read_npz(path: Path) -> tuple[dict[str, str], Arrays]:
    texts: dict[str, str] = {}
    found: Arrays = {}
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(each.file_size for each in archive.infolist())
        if unpacked > MAX_BYTES:
            raise RacinesError(f"{path}: {unpacked:,} bytes unpacked: at most {MAX_BYTES:,}")
        with np.load(path, allow_pickle=False) as held:
            for key in held.files:
                sweep, slash, kind = key.rpartition("/")
                if not slash and key in TEXTS:
                    texts[key] = _text(held[key], f"{path}: {key}")
                elif sweep and kind in KINDS:
                    found.setdefault(sweep, {})[kind] = held[key]
                else:
                    told = f"{', '.join(TEXTS)}, SWEEP/to_first and SWEEP/to_previous"
                    raise RacinesError(f"{path}: {key[:80]!r}: unknown: give {told}")
    except _NOT_NPZ as error:
        told = " ".join(str(error).split())[:200]
        raise RacinesError(f"{path}: not readable as NPZ: {told}; write it again") from error
    return texts, found


def _text(value: np.ndarray, where: str) -> str:
    if value.dtype.kind != "U" or value.ndim:
        raise RacinesError(f"{where}: {value.dtype} of shape {value.shape}: give one text")
    return str(value)


def _read_parquet(path: Path) -> tuple[dict[str, str], Arrays]:
    try:
        with pq.ParquetFile(path, memory_map=False) as file:
            told = file.metadata
            unpacked = sum(told.row_group(i).total_byte_size for i in range(told.num_row_groups))
            schema = file.schema_arrow
            _check_columns(path, schema, unpacked)
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno:
            raise
        reason = " ".join(str(error).split())[:200]
        raise RacinesError(f"{path}: not readable as Parquet: {reason}; write it again") from error
    texts = {}
    for key, value in (schema.metadata or {}).items():
        name = key.decode(errors="replace").removeprefix("racines.")
        if key.startswith(b"racines."):
            if name not in TEXTS:
                known = ", ".join(TEXTS)
                raise RacinesError(f"{path}: metadata racines.{name[:64]}: unknown; known: {known}")
            texts[name] = value.decode(errors="replace")
    return texts, _by_sweep(path, table)


def _check_columns(path: Path, schema: pa.Schema, unpacked: int) -> None:
    found = {field.name: field.type for field in schema}
    wanted = {field.name: field.type for field in COLUMNS}
    if set(found) != set(wanted) or len(schema) != len(COLUMNS):
        given = ", ".join(schema.names[:20])
        raise RacinesError(f"{path}: columns {given}: give {', '.join(wanted)} and no other")
    for name, kind in wanted.items():
        if found[name] != kind:
            raise RacinesError(f"{path}: {name}: is {found[name]}: give {kind}")
    if unpacked > MAX_BYTES:
        raise RacinesError(f"{path}: {unpacked:,} bytes unpacked: at most {MAX_BYTES:,}")


def _by_sweep(path: Path, table: pa.Table) -> Arrays:
    for name in COLUMNS.names:
        column = table[name]
        inner = [part.flatten() for part in column.chunks] if name in KINDS else []
        if column.null_count or any(part.null_count for part in inner):
            raise RacinesError(f"{path}: {name}: null in some row: fill it in")
    names, frames = table["sweep"].to_numpy(), table["frame"].to_numpy()
    cells = {}
    for kind in KINDS:
        flat = np.concatenate([part.flatten().to_numpy() for part in table[kind].chunks] or [[]])
        cells[kind] = flat.reshape(-1, 4, 4)
    every, first, which = np.unique(names.astype(str), return_index=True, return_inverse=True)
    order = np.lexsort((frames, which))
    parts = np.split(order, np.cumsum(np.bincount(which, minlength=len(every)))[:-1])
    found: Arrays = {}
    for place in np.argsort(first):  # as they come in the file
        rows, sweep = parts[place], str(every[place])
        if not np.array_equal(frames[rows], np.arange(len(rows))):
            told = "numbers from 0 on, each once, are wanted"
            raise RacinesError(f"{path}: sweep {sweep[:64]}: frame: {told}: number them so")
        found[sweep] = {kind: cells[kind][rows] for kind in KINDS}
    return found


def _transforms(value: np.ndarray, where: str) -> Tensor:
    if value.dtype not in (np.float64, np.float32):
        raise RacinesError(f"{where}: {value.dtype}: give float64")
    if value.ndim != 3 or value.shape[1:] != (4, 4) or not len(value):
        raise RacinesError(f"{where}: shape {value.shape}: give (T, 4, 4)")
    return torch.from_numpy(np.ascontiguousarray(value, np.float64))


def _check_motion(motion: Motion, where: str) -> None:
    """Refuse transforms that are no motion of a probe, with the frame."""
    counts = [len(each) for each in motion]
    if len(set(counts)) > 1:
        raise RacinesError(f"{where}: {counts[0]} and {counts[1]} frames: give each frame both")
    eye = torch.eye(3, dtype=torch.float64)
    for kind, every in zip(KINDS, motion, strict=True):
        turn, shift = every[:, :3, :3], every[:, :3, 3]
        wrong = {
            "not finite: give numbers": ~every.isfinite().flatten(1).all(1),
            "its last row is not 0 0 0 1": (every[:, 3] != every.new_tensor([0, 0, 0, 1])).any(1),
            "not a rotation: make it orthonormal": ((turn @ turn.mT - eye).abs() > RIGID)
            .flatten(1)
            .any(1),
            "mirrored: its determinant is negative": torch.linalg.det(turn.nan_to_num()) < 0,
            f"shifted by over {FARTHEST:g} m; likely in millimetres: give metres": shift.norm(dim=1)
            > FARTHEST,
        }
        for reason, rows in wrong.items():
            if bool(rows.any()):
                raise RacinesError(f"{where}: {kind} of frame {int(rows.nonzero()[0])}: {reason}")
        if float((every[0] - torch.eye(4, dtype=torch.float64)).abs().max()) > RIGID:
            told = "not the identity: frame 0 is the reference"
            raise RacinesError(f"{where}: {kind} of frame 0: {told}")
