"""Folders of recordings that nobody's code made: tables of poses and images, from sweeps."""

from pathlib import Path

import numpy as np
import polars as pl
import yaml
from PIL import Image
from scipy.spatial.transform import Rotation as Turn

from racines_data.schema import Trajectory
from racines_data.sources.table import TableSource
from racines_data.sources.tracked.source import Recording, read_frames

MATRIX = [f"m{i}{j}" for i in range(4) for j in range(4)]
QUATERNION = ["qw", "qx", "qy", "qz"]


def poses_of(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 4, 4) poses in mm and (T,) times of a PLUS sequence, as its header has them."""
    key = "ProbeToTrackerTransform"
    rows = [[float(x) for x in fields[key].split()] for fields in recording.frames]
    times = np.array([float(fields["Timestamp"]) for fields in recording.frames])
    return np.array(rows).reshape(-1, 4, 4), times


def columns_of(poses: np.ndarray, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return every column that poses (mm) could be logged by."""
    turns = Turn.from_matrix(poses[:, :3, :3])
    columns = {"t": times}
    columns |= dict(zip("xyz", poses[:, :3, 3].T, strict=True))
    columns |= dict(zip(MATRIX, poses.reshape(-1, 16).T, strict=True))
    columns |= dict(zip(QUATERNION, np.roll(turns.as_quat(), 1, axis=1).T, strict=True))
    columns |= dict(zip(("rx", "ry", "rz"), turns.as_euler("xyz").T, strict=True))
    return columns


def write_folder(folder: Path, columns: dict, images, name: str = "poses.csv") -> Path:
    """Write a table, and a PNG a row whose name stands in its column `image`."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    names = [f"frames/{row}.png" for row in range(len(next(iter(columns.values()))))]
    for file, image in zip(names, images, strict=True):
        Image.fromarray(image).save(folder / file, compress_level=1)
    pl.DataFrame({**columns, "image": names}).write_csv(folder / name)
    return folder


def write_recording(folder: Path, recording: Recording, small: bool = False) -> Path:
    """Write a PLUS sequence as CSV and PNG; `small`: an eighth of the pixels each way."""
    step = 8 if small else 1
    images = [image[::step, ::step] for image in read_frames(recording)]
    return write_folder(folder, columns_of(*poses_of(recording)), images)


QUATERNIONS = {
    "frame": "tracker",
    "segments": 5,
    "poses": {
        "file": "poses.csv",
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": ["x", "y", "z"], "unit": "mm"},
        "rotation": {"kind": "quaternion", "columns": QUATERNION, "order": "wxyz"},
    },
    "images": {"path": "{image}"},
}
MATRICES = {
    **QUATERNIONS,
    "poses": {
        "file": "poses.csv",
        "time": {"column": "t", "unit": "s"},
        "rotation": {"kind": "matrix", "columns": MATRIX, "unit": "mm"},
    },
}
EULER = {"kind": "euler", "columns": ["rx", "ry", "rz"], "order": "xyz", "unit": "rad"}


def changed(mapping: dict, **changes) -> dict:
    """Return a mapping with some values replaced; `a__b=c` is the key b of a."""
    made = yaml.safe_load(yaml.safe_dump(mapping))
    for path, value in changes.items():
        *parents, last = path.split("__")
        part = made
        for key in parents:
            part = part.setdefault(key, {})
        part[last] = value
    return made


def write_mapping(folder: Path, mapping: dict) -> Path:
    """Write mapping.yaml into a folder."""
    path = folder / "mapping.yaml"
    path.write_text(yaml.safe_dump(mapping, sort_keys=False))
    return path


COUNT, HEIGHT, WIDTH = 24, 48, 64


def synthetic(count: int = COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return poses (mm) of a probe that slides and tilts, its times, and (T, 48, 64) images."""
    at = np.linspace(0, 1, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    angles = np.stack([3.0 + 0.2 * np.sin(3 * at), 0.15 * at, 0.4 + 0.3 * at], -1)
    poses[:, :3, :3] = Turn.from_euler("xyz", angles).as_matrix()
    poses[:, :3, 3] = np.stack([480 + 30 * at, 20 * np.cos(4 * at), 75 + 5 * at**2], -1)
    images = np.random.default_rng(0).integers(0, 256, (count, HEIGHT, WIDTH), np.uint8)
    return poses, 100 + 0.04 * np.arange(count), images


def synthetic_folder(folder: Path, **columns) -> Path:
    """Write the synthetic sweep as CSV and PNG; `columns` replace or add columns."""
    poses, times, images = synthetic()
    return write_folder(folder, {**columns_of(poses, times), **columns}, images)


ROBOT = changed(QUATERNIONS, frame="robot", segments=1)


def source(folder: Path, mapping: dict, **config) -> TableSource:
    write_mapping(folder, mapping)
    return TableSource.from_config(config, [folder])


def sweep(folder: Path, mapping: dict) -> Trajectory:
    made = source(folder, mapping)
    (unit,) = made.plan()
    assert not made.report, made.report
    return made.produce(unit)


def check(made: Trajectory, expected: Trajectory, gray: int = 0) -> None:
    assert np.abs(made.parameters[:, 6:] - expected.parameters[:, 6:]).max() < 1e-6
    assert np.abs(made.timestamps - expected.timestamps).max() < 1e-9
    assert np.abs(made.images.astype(int) - expected.images).max() <= gray
