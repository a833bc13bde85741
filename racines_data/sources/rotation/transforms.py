"""The file of poses: one `transforms*.json`, with a matrix a frame.

    {"frames": [{"file_path": "…/0000.png", "transform_matrix": [[r11, r12, r13, t1], … ]}, …]}

The columns of a matrix are the image's x, its y (depth), the plane's normal, and a translation, all
in pixels of the image: pixel (x, y) lies at R (x, y, plane) + t. A frame may have a `time`, where
in the beat it is, in [0, 1); without, the frames of one pose are evenly spread over the beat.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.gate.numbers import rotation_faults
from racines_data.sources.images import Kind
from racines_data.sources.table.inputs import Folder

PATTERN = "transforms*.json"
LARGEST = 256_000_000
"""Bytes of a file of poses, at most."""
_SHAPES = (3, 4), (4, 4)
_LAST = [0.0, 0.0, 0.0, 1.0]


@dataclass(frozen=True)
class Transforms:
    """What a file of poses says of its N frames."""

    path: Path
    names: list[str]
    """`file_path` of each frame; empty where it has none."""
    matrices: np.ndarray
    """(N, 4, 4) float64, translation in pixels."""
    times: np.ndarray | None
    """(N,) float64 in [0, 1), where in the beat each frame is; None where the file does not say."""
    size: tuple[int | None, int | None]
    """Width and height of the images, pixels, where the file says them."""


def find_transforms(folder: Folder, name: str = "") -> Path:
    """Return the file of poses of a folder: the one named, else the only one.

    Raises:
        RacinesError: there is none, or there are several and none is named.
    """
    if name:
        return folder.file(name, "transforms")
    found = sorted(folder.root.glob(PATTERN)) + sorted(folder.root.glob(f"*/{PATTERN}"))
    if not found:
        raise RacinesError(
            f"{folder.root}: no file of poses ({PATTERN}): give the folder that holds it, or name "
            "it: --set transforms=NAME"
        )
    names = [folder.name(path) for path in found]
    if len(found) > 1:
        raise RacinesError(
            f"{folder.root}: {len(found)} files of poses, {', '.join(names[:4])}: name the one "
            f"that is meant: --set transforms={names[0]}"
        )
    return folder.file(names[0], "transforms")


def read_transforms(path: Path, tolerance: float) -> Transforms:
    """Read a file of poses.

    Args:
        path: The file.
        tolerance: Largest error of a rotation's orthonormality, per element of R Rᵀ - 1.

    Raises:
        RacinesError: not such a file, no frame, or a frame that has no rigid right-handed pose:
            with the file and the key.
    """
    content = _read(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise RacinesError(f"{path}: key `frames`: give a list with an entry a frame")
    matrices, names, times = np.zeros((len(frames), 4, 4)), [], np.full(len(frames), np.nan)
    for index, frame in enumerate(frames):
        where = f"{path}: frames[{index}]"
        if not isinstance(frame, dict):
            raise RacinesError(f"{where}: {str(frame)[:40]!r}: an object with keys is expected")
        names.append(_name(frame, where))
        matrices[index] = _matrix(frame, f"{where}.transform_matrix")
        if "time" in frame:
            times[index] = _number(frame["time"], f"{where}.time")
    for index, fault in enumerate(rotation_faults(matrices, tolerance)):
        if fault:
            said = "mirrored: " if fault.kind is Kind.REFLECTED else ""
            raise RacinesError(f"{path}: frames[{index}].transform_matrix: {said}{fault}")
    told = content.get("w"), content.get("h")
    size = tuple(None if each is None else int(_finite(each, f"{path}: w, h")) for each in told)
    return Transforms(path, names, matrices, _times(path, times), (size[0], size[1]))


def _read(path: Path) -> Any:
    size = path.stat().st_size
    if size > LARGEST:
        raise RacinesError(f"{path}: {size / 1e6:.0f} MB, at most {LARGEST / 1e6:.0f}: no poses")
    try:
        return json.loads(path.read_bytes().decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: not JSON ({error}): write it again") from error


def _name(frame: dict[str, Any], where: str) -> str:
    name = frame.get("file_path", "")
    if not isinstance(name, str):
        raise RacinesError(f"{where}.file_path: {name!r}: give a file's name")
    return name


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RacinesError(f"{where}: {str(value)[:40]!r} is no number")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _finite(value: Any, where: str) -> float:
    number = _number(value, where)
    if not math.isfinite(number):
        raise RacinesError(f"{where}: {str(value)[:40]} is not finite")
    return number


def _matrix(frame: dict[str, Any], where: str) -> np.ndarray:
    """Return a frame's (4, 4) matrix, the last row added where the file leaves it out."""
    if "transform_matrix" not in frame:
        known = ", ".join(map(str, frame)) or "none"
        raise RacinesError(f"{where}: missing; the frame has {known}")
    rows = frame["transform_matrix"]
    try:
        for number in (number for row in rows for number in row):
            _number(number, where)
        matrix = np.array(rows, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in _SHAPES:
        raise RacinesError(f"{where}: not a matrix of 3 × 4 or 4 × 4 numbers")
    if not np.isfinite(matrix).all():
        raise RacinesError(f"{where}: {Kind.NAN}: has numbers that are not finite")
    return matrix if len(matrix) == 4 else np.concatenate([matrix, [_LAST]])


def _times(path: Path, times: np.ndarray) -> np.ndarray | None:
    known = np.isfinite(times)
    if not known.any():
        return None
    if not known.all():
        index = int(np.flatnonzero(~known)[0])
        raise RacinesError(f"{path}: frames[{index}].time: missing, where others have one")
    outside = (times < 0) | (times >= 1)
    if outside.any():
        index = int(np.flatnonzero(outside)[0])
        raise RacinesError(
            f"{path}: frames[{index}].time: {times[index]:g} is no phase of a beat: give it in "
            "[0, 1), the end of a beat being the start of the next"
        )
    return times
