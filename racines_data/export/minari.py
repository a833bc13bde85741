"""A dataset as Minari datasets, one a split: offline trajectories for reinforcement learning.

    OUT/racines/phantom-train-v1/data/metadata.json      spaces, counts, what the numbers mean
    OUT/racines/phantom-train-v1/data/<episode>/…        one Arrow record batch an episode

Format: Minari's `arrow` storage (Farama Foundation, minari 0.5). An episode is a trajectory of T
frames, hence T-1 steps:

    observation   o_0   o_1   …   o_T-1     image (1, 128, 128) uint8, params (12,) float32
    action          a_0   a_1   …           commanded velocity at the frame before the move
    reward          r_0   r_1   …           F(o_t+1) - F(o_t), F the grade as the target view
    info          view, grade, timestamp and frame of every observation

The dataset has no reward of its own: it depends on the task. This one is the change of a
potential, so it sums to what a sweep has gained and no lingering farms it; F is 0 where another
view shows, and where a grade is unknown next to a step its reward is 0. No sweep ends in a terminal
state: the last step is a truncation. Images have a leading channel axis because Minari stores
(H, W) images as JPEG unless told not to, and older versions cannot be told; pixels stay as they
are.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import ipc

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import describe, manifest_labels, read_manifest
from racines_data.progress import progress_bar
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.store.sweeps import Sweep, new_folder, read_sweeps

MINARI_VERSION = "0.5.0"
"""Oldest version whose format this is; later ones read it."""


def export(
    root: Path,
    out: Path,
    split: str | None = None,
    limit: int | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Write a dataset for Minari; set `MINARI_DATASETS_PATH` to `out` to load it.

    Arguments and errors as of `registry.Exporter`, and an error where there is no commanded
    velocity. Each split is a Minari dataset; these have whole versions, hence the first number
    only. Returns `out`, the `datasets` by id with their episodes and steps, counts, and notes.
    """
    manifest = read_manifest(root)
    labels, major = manifest_labels(manifest), manifest["version"].split(".")[0]
    written: dict[str, dict[str, int]] = {}
    missing = frames = 0
    with new_folder(out) as folder, progress_bar(progress) as bar:
        task = bar.add_task("frames", total=None)
        for sweep in read_sweeps(root, split, limit):
            name = f"racines/{manifest['source']}-{sweep.split}-v{major}"
            counts = written.setdefault(name, {"episodes": 0, "steps": 0})
            missing += _write_episode(folder / name / "data", counts["episodes"], sweep, labels)
            counts["episodes"] += 1
            counts["steps"] += len(sweep) - 1
            frames += len(sweep)
            bar.advance(task, len(sweep))
        steps = sum(counts["steps"] for counts in written.values())
        if steps and missing == steps:
            raise RacinesError(
                f"{root}: {manifest['source']} data have no commanded velocity, hence no actions"
            )
        for name, counts in written.items():
            _write_metadata(folder / name / "data", name, manifest, counts)
        about = {"description": f"RACINES: {describe(manifest)}"}
        (folder / "racines" / "namespace_metadata.json").write_text(json.dumps(about))
    return {
        "out": str(out),
        "format": "minari",
        "frames": frames,
        "trajectories": sum(counts["episodes"] for counts in written.values()),
        "datasets": written,
        "notes": [f"{missing} of {steps} steps have no commanded velocity: NaN"] if missing else [],
    }


def _write_episode(data: Path, episode: int, sweep: Sweep, labels: tuple[str, ...]) -> int:
    """Write one episode; return how many of its steps have no commanded velocity."""
    table, count = sweep.table, len(sweep)
    target, random = sweep.first("target_view"), labels[-1]
    actions = float_columns(table, CONTROLS)
    views = table["view"].fill_null(-1).to_numpy()
    grades = float_columns(table, ["grade"])[:, 0]
    rewards = _rewards(views, grades, labels.index(target))
    if target == random:
        rewards = np.zeros_like(rewards)  # a random scan has no target
    images, parameters = sweep.images().reshape(count, -1), float_columns(table, PARAMETERS)
    infos = {
        "view": pa.array(views),
        "grade": pa.array(grades),
        "timestamp": table["timestamp"].combine_chunks(),
        "frame": table["frame"].combine_chunks(),
    }
    batch = pa.RecordBatch.from_pydict(
        {
            "observations": _struct({"image": _fixed(images), "params": _fixed(parameters)}),
            "actions": _fixed(actions),  # the last one leads nowhere; Minari drops it
            "rewards": np.append(rewards, 0.0),
            "terminations": np.zeros(count, bool),
            "truncations": np.arange(count) == count - 2,
            "infos": _struct(infos),
        }
    )
    folder = data / str(episode)
    folder.mkdir(parents=True)
    options = ipc.IpcWriteOptions(compression="zstd")
    with ipc.new_file(str(folder / "part-0.arrow"), batch.schema, options=options) as writer:
        writer.write_batch(batch)
    about = {"id": episode, "total_steps": count - 1, "split": sweep.split}
    about |= {k: sweep.first(k) for k in ("trajectory", "session", "target_view", "phantom")}
    (folder / "metadata.json").write_text(json.dumps(about))
    return int(np.isnan(actions[:-1]).any(-1).sum())


def _rewards(views: np.ndarray, grades: np.ndarray, target: int) -> np.ndarray:
    """Return (T-1,) float64: the change of the grade as the target view, 0 where unknown."""
    potential = np.where(views == target, grades, 0.0).astype(np.float64)
    potential[views == -1] = np.nan
    return np.nan_to_num(np.diff(potential))


def _fixed(values: np.ndarray) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _struct(columns: Mapping[str, pa.Array]) -> pa.StructArray:
    return pa.StructArray.from_arrays([*columns.values()], [*columns])


def _write_metadata(
    data: Path, name: str, manifest: Mapping[str, Any], counts: Mapping[str, int]
) -> None:
    image = _box((1, IMAGE_SIZE, IMAGE_SIZE), 0, 255, "uint8")
    params = _box((len(PARAMETERS),), -np.inf, np.inf, "float32")
    action = _box((len(CONTROLS),), -np.inf, np.inf, "float32")
    spaces = {"type": "Dict", "subspaces": {"image": image, "params": params}}
    size = sum(path.stat().st_size for path in data.rglob("*") if path.is_file())
    metadata = {
        "dataset_id": name,
        "minari_version": MINARI_VERSION,
        "data_format": "arrow",
        "jpeg_encoding": False,
        "total_episodes": counts["episodes"],
        "total_steps": counts["steps"],
        "observation_space": json.dumps(spaces),
        "action_space": json.dumps(action),
        "dataset_size": round(size / 1e6, 1),
        "author": ["The RACINES developers"],
        "algorithm_name": "recorded sweeps",
        "description": _description(manifest),
        "racines": {key: manifest[key] for key in ("source", "version", "digest", "recipe_digest")},
    }
    (data / "metadata.json").write_text(json.dumps(metadata))


def _description(manifest: Mapping[str, Any]) -> str:
    labels = ", ".join(f"{index} {name}" for index, name in enumerate(manifest_labels(manifest)))
    return (
        f"RACINES, {describe(manifest)}. Observation: image (1, 128, 128), 8-bit gray, unchanged; "
        f"params: {', '.join(PARAMETERS)} (N, N·m, m, rad; robot base frame; NaN where unknown). "
        "Action: the commanded velocity at the frame before the step (m/s, rad/s; base frame). "
        "Reward: the change of the grade as the target view (0 where another view shows or a grade "
        "is unknown); the recordings themselves have none. No terminations; the last step of a "
        f"sweep is a truncation. Infos, one an observation: view ({labels}; -1 unknown), grade "
        "(0-10; NaN unknown), timestamp (s), frame. Research data, not for clinical use."
    )


def _box(shape: tuple[int, ...], low: float, high: float, dtype: str) -> dict[str, Any]:
    bounds = {"low": np.full(shape, low).tolist(), "high": np.full(shape, high).tolist()}
    return {"type": "Box", "dtype": dtype, "shape": list(shape), **bounds}
