"""From columns to rigid transforms: (T, 4, 4) float64, metres, nothing normalised in silence."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation as Turn

from racines_data.errors import RacinesError
from racines_data.sources.gate.numbers import LENGTHS, rotation_faults
from racines_data.sources.table.mapping import (
    Calibration,
    Euler,
    Matrix4,
    NoRotation,
    Poses,
    Quaternion,
    RotationMatrix,
    RotationVector,
)
from racines_data.sources.table.rows import numbers

UNIT = 5e-3
"""By so much may the length of a quaternion differ from 1."""


def read_poses(table: pl.DataFrame, poses: Poses, path: Path) -> np.ndarray:
    """Return (T, 4, 4) poses in metres as the columns have them, before calibration.

    A quaternion that is not unit scales its matrix by its length, so that it is seen. Rows without
    numbers are NaN.

    Raises:
        RacinesError: a column is missing, holds no numbers, or not as many as the mapping says.
    """
    rotation, count = poses.rotation, len(table)
    made = np.tile(np.eye(4), (count, 1, 1))
    if isinstance(rotation, RotationMatrix):
        made = _matrices(table, rotation, path)
    elif not isinstance(rotation, NoRotation):
        values = _values(table, rotation, path)
        made[:, :3, :3] = turned(values, rotation)
    if poses.position is not None:
        places = numbers(table, poses.position.columns, "poses.position.columns", path)
        _check_width(places, (3,), "poses.position.columns", path)
        made[:, :3, 3] = places * LENGTHS[poses.position.unit]
    return made


def _values(table: pl.DataFrame, rotation: Any, path: Path) -> np.ndarray:
    field = "poses.rotation.columns"
    values = numbers(table, rotation.columns, field, path)
    _check_width(values, (4,) if isinstance(rotation, Quaternion) else (3,), field, path)
    return values


def _check_width(values: np.ndarray, widths: tuple[int, ...], field: str, path: Path) -> None:
    if values.shape[1] not in widths:
        several = " or ".join(map(str, widths))
        raise RacinesError(
            f"{path}: {field}: {values.shape[1]} numbers a row, where {several} are needed"
        )


def turned(values: np.ndarray, rotation: Quaternion | Euler | RotationVector) -> np.ndarray:
    """Return (T, 3, 3) of quaternions, angles or vectors; NaN where they are not numbers."""
    made = np.full((len(values), 3, 3), np.nan)
    known = np.isfinite(values).all(1)
    values = values[known]
    if isinstance(rotation, Quaternion):
        length = np.linalg.norm(values, axis=1)
        none = length == 0
        ordered = np.roll(values, -1, axis=1) if rotation.order == "wxyz" else values
        ordered = np.where(none[:, None], [0.0, 0.0, 0.0, 1.0], ordered)
        sizes = np.where(np.abs(length - 1) > UNIT, length, 1.0)
        made[known] = Turn.from_quat(ordered).as_matrix() * sizes[:, None, None]
    elif isinstance(rotation, Euler):
        degrees = rotation.unit == "deg"
        made[known] = Turn.from_euler(rotation.order, values, degrees=degrees).as_matrix()
    else:
        radians = np.radians(values) if rotation.unit == "deg" else values
        made[known] = Turn.from_rotvec(radians).as_matrix()
    return made


def _matrices(table: pl.DataFrame, rotation: RotationMatrix, path: Path) -> np.ndarray:
    field = "poses.rotation.columns"
    values = numbers(table, rotation.columns, field, path)
    _check_width(values, (9, 12, 16), field, path)
    whole = values.shape[1] > 9
    if whole == (rotation.unit is None):
        said = "say its unit: poses.rotation.unit" if whole else "it holds no position: add one"
        raise RacinesError(f"{path}: {field}: {values.shape[1]} numbers a row: {said}")
    made = laid_out(values, rotation.layout)
    if whole:
        made[:, :3, 3] *= LENGTHS[rotation.unit or "m"]
    return made


def laid_out(values: np.ndarray, layout: str) -> np.ndarray:
    """Return (T, 4, 4) of (T, 9), (T, 12) or (T, 16) numbers by rows or by columns."""
    made = np.tile(np.eye(4), (len(values), 1, 1))
    rows = {9: 3, 12: 3, 16: 4}[values.shape[1]]
    wide = values.shape[1] // rows
    if layout == "rows":
        made[:, :rows, :wide] = values.reshape(-1, rows, wide)
    else:
        made[:, :rows, :wide] = values.reshape(-1, wide, rows).transpose(0, 2, 1)
    return made


def calibrate(poses: np.ndarray, calibration: Calibration, invert: bool) -> np.ndarray:
    """Return (T, 4, 4) poses of what is imaged in the frame that the mapping means.

    base <- tracker_to_base <- [row, or its inverse] <- probe_to_tracker <- image_to_probe
    """
    made = inverse(poses) if invert else poses
    metres = LENGTHS[calibration.unit]
    for name in ("probe_to_tracker", "image_to_probe"):
        if (held := getattr(calibration, name)) is not None:
            scaled = name == "image_to_probe" and calibration.image_scaled
            made = made @ constant(held, metres, f"calibration.{name}", scaled)
    if calibration.tracker_to_base is not None:
        made = constant(calibration.tracker_to_base, metres, "calibration.tracker_to_base") @ made
    return made


def constant(values: Matrix4, metres: float, field: str, scaled: bool = False) -> np.ndarray:
    """Return a constant transform, (4, 4), metres.

    Raises:
        RacinesError: it is not rigid, with the likely cause.
    """
    matrix = np.array(values, float)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if scaled and (lengths > 0).all():
        matrix[:3, :3] /= lengths
    if (fault := rotation_faults(matrix[None])[0]) is not None:
        hint = ""
        if not scaled and (np.abs(lengths - 1) > 1e-3).any():
            shown = ", ".join(f"{each:.4g}" for each in lengths)
            hint = f"; its columns have lengths {shown}: if it maps pixels, set image_scaled: true"
        raise RacinesError(f"{field}: {fault}{hint}")
    matrix[:3, 3] *= metres
    return matrix


def inverse(poses: np.ndarray) -> np.ndarray:
    """Return the inverses of (T, 4, 4) rigid transforms."""
    made = np.tile(np.eye(4), (len(poses), 1, 1))
    made[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    made[:, :3, 3] = -np.einsum("tji,tj->ti", poses[:, :3, :3], poses[:, :3, 3])
    return made
