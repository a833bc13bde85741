"""A dataset in the LeRobot format, v3.0: images stay PNG in Parquet, byte for byte; no video.

    meta/info.json                              features, counts, splits as ranges of episodes
    meta/stats.json                             statistics of every feature
    meta/tasks.parquet                          one task a target view
    meta/episodes/chunk-000/file-000.parquet    one row a trajectory: bounds, task, statistics
    meta/racines.json                           source, version, digests, labels, episodes by target
    data/chunk-000/file-000.parquet             one row a frame, whole trajectories a file

Format: LeRobotDataset v3.0 (Hugging Face, lerobot 0.4 to 0.6). An episode is a trajectory.
`timestamp` is seconds since its first frame. `action` is the commanded velocity at the frame.
Images have one channel, as recorded; `view` is -1 and numbers are NaN where unknown. Sweeps that
were drawn for an arm have its `observation.joints`, rad, besides.
"""

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from datasets import Features, Image, List, Value
from PIL import Image as Picture

from racines_data.errors import RacinesError
from racines_data.export.lerobot.statistics import histogram, image_statistics, statistics
from racines_data.files import write_json
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import (
    ADDED,
    config_manifest,
    describe,
    manifest_labels,
    read_manifest,
)
from racines_data.phantom.pacing import FREE, joint_count, recorded_joints, recorded_robot
from racines_data.progress import progress_bar
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS, PHASES, SPLITS
from racines_data.sources.base import rights_of
from racines_data.store.sweeps import Sweep, new_folder, read_sweeps
from racines_data.tables import escape

IMAGE, STATE, ACTION = "observation.images.ultrasound", "observation.state", "action"
CHUNK_FILES = 1000
FILE_MEGABYTES = 100
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_INDICES = ("frame_index", "episode_index", "index", "task_index")
_FEATURES: dict[str, dict[str, Any]] = {
    name: {"dtype": dtype, "shape": shape, "names": names}
    for name, dtype, shape, names in (
        (IMAGE, "image", [IMAGE_SIZE, IMAGE_SIZE, 1], ["height", "width", "channels"]),
        (STATE, "float32", [12], list(PARAMETERS)),
        (ACTION, "float32", [6], list(CONTROLS)),
        ("view", "int64", [1], None),
        ("grade", "float32", [1], None),
        ("timestamp", "float32", [1], None),
        *((name, "int64", [1], None) for name in _INDICES),
    )
}
MASK, JOINTS = "observation.images.mask", "observation.joints"
_OF_PATIENTS: dict[str, dict[str, Any]] = {
    "patient": {"dtype": "int64", "shape": [1], "names": None},
    **{name: {"dtype": "float32", "shape": [1], "names": None} for name in PHASES},
}
"""What frames of patients have besides; and a mask, an image, where they have one."""


def _as_recorded(sweep: Sweep) -> dict[str, np.ndarray]:
    return {
        STATE: float_columns(sweep.table, PARAMETERS),
        ACTION: float_columns(sweep.table, CONTROLS),
    }


@dataclass(frozen=True)
class Shown:
    """What a policy is shown of a sweep beside images, and what it is to do."""

    name: str = "lerobot"
    """The format's."""
    columns: Callable[[Sweep], dict[str, np.ndarray]] = _as_recorded
    """Gives `observation.state` and `action`, float32 (T, D) each; NaN where unknown."""
    state: tuple[str, ...] = PARAMETERS
    """Names of the numbers of `observation.state`."""
    action: tuple[str, ...] = CONTROLS
    """Names of the numbers of `action`."""
    told: str = (
        "`observation.state` and `action` in the robot's base frame: m, rad, N, N·m; m/s, rad/s."
    )
    """What the dataset's README says of them."""

    def features(self, channels: int) -> dict[str, Any]:
        """Return the features of images, state and action, as `meta/info.json` has them."""
        shape = [*_FEATURES[IMAGE]["shape"][:2], channels]
        made = {IMAGE: _FEATURES[IMAGE] | {"shape": shape}}
        for name, of in ((STATE, self.state), (ACTION, self.action)):
            made[name] = {"dtype": "float32", "shape": [len(of)], "names": list(of)}
        return made


RECORDED = Shown()


def export(
    root: Path,
    out: Path,
    split: str | None = None,
    limit: int | None = None,
    progress: bool = False,
    config: str = "frames",
    channels: int = 1,
    shown: Shown = RECORDED,
) -> dict[str, Any]:
    """Write a dataset in the LeRobot format: `LeRobotDataset(NAME, root=out)` opens it.

    Arguments and errors as of `registry.Exporter`, and an error where there is no commanded
    velocity. A config of patients has their columns besides, and masks as images of labels, which
    `meta/racines.json` names by number. Images have one channel, or three equal ones. State and
    action are those of `shown`. Returns `out`, counts, `fps`, `splits` as ranges of episodes, and
    notes.
    """
    manifest = config_manifest(read_manifest(root), config)
    with new_folder(out) as folder, progress_bar(progress) as bar:
        task = bar.add_task("frames", total=None)
        robot = recorded_robot(manifest, config)
        features = features_of(manifest, config) | shown.features(channels) | _joints(robot)
        writer = _Writer(folder, manifest_labels(manifest), features, shown, robot)
        for sweep in read_sweeps(root, split, limit, config):
            writer.add(sweep)
            bar.advance(task, len(sweep))
        writer.close()
        missing = sum(int(np.isnan(each).any(-1).sum()) for each in writer.columns[ACTION])
        if missing == writer.frames:
            raise RacinesError(
                f"{root}: {manifest['source']} data have no commanded velocity, hence no actions"
            )
        info = _write_meta(folder, writer, manifest, config)
    note = f"{missing} of {writer.frames} frames have no commanded velocity: NaN"
    return {
        "out": str(out),
        "format": shown.name,
        "frames": writer.frames,
        "trajectories": len(writer.episodes),
        "fps": info["fps"],
        "splits": info["splits"],
        "notes": [note] if missing else [],
    }


def task_of(target_view: str, random: str) -> str:
    """Return the sentence that tells a policy what a sweep aims at."""
    if target_view == random:
        return "Scan freely, with no target view."
    return f"Move the probe until the image shows the {target_view} view."


@dataclass
class _Writer:
    """Writes the frames, whole trajectories a file, and keeps what the metadata need."""

    folder: Path
    labels: tuple[str, ...]
    features: dict[str, dict[str, Any]]
    shown: Shown
    robot: str
    frames: int = 0
    episodes: list[dict[str, Any]] = field(default_factory=list)
    tasks: dict[str, int] = field(default_factory=dict)
    intervals: list[np.ndarray] = field(default_factory=list)
    columns: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """Numbers of each feature, by episode."""
    histograms: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """Gray levels, or labels, of each image feature, by episode."""
    _files: int = 0
    _bytes: int = 0
    _open: pq.ParquetWriter | None = None

    def add(self, sweep: Sweep) -> None:
        """Write one trajectory as the next episode."""
        task = task_of(sweep.first("target_view"), self.labels[-1])
        index = self.tasks.setdefault(task, len(self.tasks))
        columns = self.shown.columns(sweep)
        if JOINTS in self.features:
            columns[JOINTS] = recorded_joints(float_columns(sweep.table, PARAMETERS), self.robot)
        columns |= _columns(sweep, len(self.episodes), self.frames, index)
        if "patient" in self.features:
            columns["patient"] = sweep.table["patient"].to_numpy()
            columns |= {name: float_columns(sweep.table, [name])[:, 0] for name in PHASES}
        chunk, number = self._write(sweep, columns)
        own: dict[str, Any] = {}
        for name in images_of(self.features):
            counted = histogram(sweep.pngs(images_of(self.features)[name]), self.frames)
            self.histograms.setdefault(name, []).append(counted)
            own[name] = image_statistics([counted], self.features[name]["shape"][2])
        for name, values in columns.items():
            self.columns.setdefault(name, []).append(values)
            own[name] = statistics([values])
        self.intervals.append(np.diff(sweep.table["timestamp"].to_numpy()))
        about = ("trajectory", "session", "target_view", "phantom")
        self.episodes.append(
            {
                "episode_index": len(self.episodes),
                "tasks": [task],
                "length": len(sweep),
                "data/chunk_index": chunk,
                "data/file_index": number,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + len(sweep),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "split": sweep.split,
                **{name: sweep.first(name) for name in about},
                **{f"stats/{name}/{key}": v for name in own for key, v in own[name].items()},
            }
        )
        self.frames += len(sweep)

    def _write(self, sweep: Sweep, columns: Mapping[str, np.ndarray]) -> tuple[int, int]:
        """Write the rows; return the chunk and the number of the file they went to."""
        features, images = hf_features(self.features), images_of(self.features)
        arrays = [
            self._images(sweep, name) if name in images else _array(columns[name])
            for name in features
        ]
        table = pa.table(arrays, schema=features.arrow_schema)
        if self._open is not None and self._bytes + table.nbytes > FILE_MEGABYTES * 2**20:
            self.close()
        chunk, number = divmod(self._files, CHUNK_FILES)
        if self._open is None:
            path = self.folder / _DATA.format(chunk_index=chunk, file_index=number)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open = pq.ParquetWriter(path, table.schema, use_dictionary=False)
        self._open.write_table(table)
        self._bytes += table.nbytes
        return chunk, number

    def _images(self, sweep: Sweep, name: str) -> pa.Array:
        """Return the PNG files of an image feature, as recorded or with three equal channels."""
        held = sweep.table[images_of(self.features)[name]].combine_chunks()
        if self.features[name]["shape"][2] == 1:
            return held
        made = [{"bytes": _coloured(png), "path": None} for png in sweep.pngs("image")]
        return pa.array(made, held.type)

    def close(self) -> None:
        """End the file that is being written."""
        if self._open is not None:
            self._open.close()
            self._open, self._bytes, self._files = None, 0, self._files + 1


def features_of(manifest: Mapping[str, Any], config: str) -> dict[str, dict[str, Any]]:
    """Return the features of a config's frames, as `meta/info.json` has them."""
    if config not in ADDED:
        return _FEATURES
    masked = {MASK: _FEATURES[IMAGE]} if manifest["mask_labels"] else {}
    return {**_FEATURES, **_OF_PATIENTS, **masked}


def _joints(robot: str) -> dict[str, dict[str, Any]]:
    """Return the feature of an arm's joints; none of a free probe."""
    if robot == FREE:
        return {}
    count = joint_count(robot)
    names = [f"joint_{number}" for number in range(1, count + 1)]
    return {JOINTS: {"dtype": "float32", "shape": [count], "names": names}}


def images_of(features: Mapping[str, Any]) -> dict[str, str]:
    """Return the image features, each with the column that it is."""
    return {name: column for name, column in ((IMAGE, "image"), (MASK, "mask")) if name in features}


def hf_features(features: Mapping[str, Mapping[str, Any]]) -> Features:
    """Return features as `datasets` has them, images first."""
    images = images_of(features)
    made: dict[str, Any] = {name: Image() for name in images}
    for name, about in features.items():
        if name not in images:
            value, size = Value(about["dtype"]), about["shape"][0]
            made[name] = value if size == 1 else List(value, length=size)
    return Features(made)


def _columns(sweep: Sweep, episode: int, start: int, task: int) -> dict[str, np.ndarray]:
    table, count = sweep.table, len(sweep)
    times = table["timestamp"].to_numpy()
    return {
        "view": table["view"].fill_null(-1).to_numpy(),
        "grade": float_columns(table, ["grade"])[:, 0],
        "timestamp": (times - times[0]).astype(np.float32),
        "frame_index": np.arange(count),
        "episode_index": np.full(count, episode),
        "index": np.arange(start, start + count),
        "task_index": np.full(count, task),
    }


def _coloured(png: bytes) -> bytes:
    buffer = io.BytesIO()
    Picture.open(io.BytesIO(png)).convert("RGB").save(buffer, "PNG")
    return buffer.getvalue()


def _array(values: np.ndarray) -> pa.Array:
    flat = pa.array(values.ravel())
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _write_meta(
    folder: Path, writer: _Writer, manifest: Mapping[str, Any], config: str
) -> dict[str, Any]:
    info = {
        "codebase_version": "v3.0",
        "robot_type": f"racines-{manifest['source']}" if writer.robot == FREE else writer.robot,
        "total_episodes": len(writer.episodes),
        "total_frames": writer.frames,
        "total_tasks": len(writer.tasks),
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MEGABYTES,
        "video_files_size_in_mb": 200,
        "fps": _rate(writer.intervals),
        "splits": _splits(writer.episodes),
        "data_path": _DATA,
        "video_path": None,
        "features": writer.features,
    }
    write_json(folder / "meta/info.json", info)
    found: dict[str, Any] = {
        name: image_statistics(each, writer.features[name]["shape"][2])
        for name, each in writer.histograms.items()
    }
    found |= {name: statistics(parts) for name, parts in writer.columns.items()}
    write_json(folder / "meta/stats.json", found)
    about = {key: manifest[key] for key in ("source", "version", "digest", "recipe_digest")}
    about |= {"labels": list(writer.labels), "description": describe(manifest, config)}
    about |= rights_of(manifest) | {"episodes": _aims(writer.episodes)}
    if MASK in writer.features:
        about["mask_labels"] = list(manifest["mask_labels"])
    write_json(folder / "meta/racines.json", about)
    tasks = pd.Series(writer.tasks, name="task_index").rename_axis("task").to_frame()
    tasks.to_parquet(folder / "meta/tasks.parquet")
    path = folder / "meta/episodes/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(writer.episodes), path)
    (folder / "README.md").write_text(
        _card(describe(manifest, config), info, writer.shown, about["attribution"]),
        encoding="utf-8",
    )
    return info


def _rate(intervals: list[np.ndarray]) -> int | float:
    """Return frames per second: the median, whole if it is within a thousandth of a whole one."""
    gaps = np.concatenate(intervals)
    gaps = gaps[gaps > 0]
    rate = float(1 / np.median(gaps)) if len(gaps) else 1.0
    return round(rate) if round(rate) and abs(rate - round(rate)) < 1e-3 * rate else round(rate, 3)


def _splits(episodes: list[dict[str, Any]]) -> dict[str, str]:
    inside = {s: [e["episode_index"] for e in episodes if e["split"] == s] for s in SPLITS}
    return {split: f"{of[0]}:{of[-1] + 1}" for split, of in inside.items() if of}


def _aims(episodes: list[dict[str, Any]]) -> dict[str, dict[str, list[int]]]:
    """Return the episodes of each split by target view: `--dataset.episodes` takes such a list."""
    found: dict[str, dict[str, list[int]]] = {}
    for each in episodes:
        aimed = found.setdefault(each["split"], {}).setdefault(each["target_view"], [])
        aimed.append(each["episode_index"])
    return found


def _card(described: str, info: Mapping[str, Any], shown: Shown, maker: str) -> str:
    return (
        "---\ntags: [LeRobot, ultrasound, robotics]\ntask_categories: [robotics]\n"
        'configs:\n- config_name: default\n  data_files: "data/*/*.parquet"\n---\n'
        f"**RACINES, {escape(described)}.**\n\n"
        f"LeRobot v3.0: {info['total_episodes']} episodes, "
        f"{info['total_frames']} frames at {info['fps']} per second; splits as ranges of episodes: "
        f"{json.dumps(info['splits'])}.\n\nMade by: {escape(maker)}.\n\n"
        f"{shown.told} Images have one channel, or three equal "
        "ones (`--format lerobot-rgb` or `lerobot-task`), which policies such as ACT want.\n\n"
        "Research data, not for clinical use.\n"
    )
