"""A dataset as Minari datasets, one a split: offline trajectories for reinforcement learning.

    OUT/racines/phantom-train-v1/data/metadata.json      spaces, counts, what the numbers mean
    OUT/racines/phantom-train-v1/data/<episode>/…        one Arrow record batch an episode

Format: Minari's `arrow` storage (Farama Foundation, minari 0.5). An episode is a trajectory of T
frames, hence T-1 steps:

    observation   o_0   o_1   …   o_T-1     image (1, 128, 128) uint8, params (12,) float32, and of
                                            sweeps for an arm its joints (J,) float32, rad
    action          a_0   a_1   …           commanded velocity at the frame before the move
    reward          r_0   r_1   …           the task's `oracle` reward for coming to o_t+1
    termination     0     0     …           1 where the hits in a row reach what ends the task
    info          view, grade, timestamp and frame of every observation

A recording has no reward of its own: it depends on the task, which is to find the sweep's target
view. Reward and termination are those of `racines/<VIEW>-v0` (`racines_envs.task.rewards.ORACLE`),
with the oracle's label and grade that the dataset holds: p is 1 where the target shows, else 0, and
g its grade. The recording goes on after a termination, and so does the episode. A step next to a
frame whose view or grade is unknown has reward 0, and so has all of a random scan, which has no
target; the last step is a truncation, unless it is a termination.

`env_spec` is the task at which most sweeps aim, in the phantom that was scanned, with images and
parameters as observations and the same reward: `recover_environment()` makes it, and with
`view=…` that of another target. Its actions are the task's 13 unit steps, not a velocity; with
`action="velocity"` they are twists in the probe's frame (`twist_of` of the LeRobot formats makes
them of velocities in the base frame), which the tasks limit and recorded hands exceed.

Images have a leading channel axis because Minari stores (H, W) images as JPEG unless told not to,
and older versions cannot be told; pixels stay as they are.
"""

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pyarrow as pa
import torch
from pyarrow import ipc

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import (
    ADDED,
    config_manifest,
    describe,
    manifest_labels,
    read_manifest,
)
from racines_data.phantom.config import PhantomConfig, recorded_phantom
from racines_data.phantom.pacing import FREE, joint_count, recorded_joints, recorded_robot
from racines_data.progress import progress_bar
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS, PHASES
from racines_data.sources.base import maker_of, rights_of
from racines_data.sources.licence import credited
from racines_data.store.sweeps import Sweep, new_folder, read_sweeps
from racines_envs.task.names import task_id
from racines_envs.task.rewards import ORACLE, RewardConfig, Score, is_hit
from racines_envs.task.tasks import Task

MINARI_VERSION = "0.5.0"
"""Oldest version whose format this is; later ones read it."""


def export(
    root: Path,
    out: Path,
    split: str | None = None,
    limit: int | None = None,
    progress: bool = False,
    config: str = "frames",
) -> dict[str, Any]:
    """Write a dataset for Minari; set `MINARI_DATASETS_PATH` to `out` to load it.

    Arguments and errors as of `registry.Exporter`, and an error where there is no commanded
    velocity. Infos of the configs of patients have their columns, and masks. Each split is a Minari
    dataset; these have whole versions, hence the first number only. Returns `out`, the `datasets`
    by id with their episodes and steps, counts, and notes.
    """
    manifest = config_manifest(read_manifest(root), config)
    labels, major = manifest_labels(manifest), manifest["version"].split(".")[0]
    written: dict[str, dict[str, int]] = {}
    aims: dict[str, Counter[str]] = {}
    missing, frames, alone, robot = 0, 0, 0, recorded_robot(manifest, config)
    with new_folder(out) as folder, progress_bar(progress) as bar:
        task = bar.add_task("frames", total=None)
        for sweep in read_sweeps(root, split, limit, config):
            if len(sweep) < 2:  # a step lies between two frames
                alone += 1
                continue
            name = f"racines/{manifest['source']}-{sweep.split}-v{major}"
            counts = written.setdefault(name, {"episodes": 0, "steps": 0})
            place = folder / name / "data"
            missing += _write_episode(place, counts["episodes"], sweep, labels, robot)
            counts["episodes"] += 1
            counts["steps"] += len(sweep) - 1
            aims.setdefault(name, Counter()).update([sweep.first("target_view")])
            frames += len(sweep)
            bar.advance(task, len(sweep))
        steps = sum(counts["steps"] for counts in written.values())
        if missing == steps:
            # Which of both shows in no frame that stands alone.
            alone_told = "no sweep has two frames, hence no step, or " * (not steps)
            raise RacinesError(
                f"{root}: {alone_told}{manifest['source']} data have no commanded velocity, hence "
                "no actions"
            )
        for name, counts in written.items():
            common = [view for view, _ in aims[name].most_common()]
            if config in ADDED:
                spec = patients_spec(config, name.split("-")[-2], common, robot)
            else:
                spec = env_spec(manifest, common, robot)
            told = _description(manifest, config, robot)
            _write_metadata(folder / name / "data", name, manifest, counts, spec, told, robot)
        about = {"description": f"RACINES: {describe(manifest, config)}"}
        notes = [f"{missing} of {steps} steps have no commanded velocity: NaN"] * bool(missing)
        notes += [f"{alone} sweeps of one frame have no step and are left out"] * bool(alone)
        (folder / "racines" / "namespace_metadata.json").write_text(
            json.dumps(about), encoding="utf-8"
        )
    return {
        "out": str(out),
        "format": "minari",
        "frames": frames,
        "trajectories": sum(counts["episodes"] for counts in written.values()),
        "datasets": written,
        "notes": notes,
    }


def _write_episode(
    data: Path, episode: int, sweep: Sweep, labels: tuple[str, ...], robot: str
) -> int:
    """Write one episode; return how many of its steps have no commanded velocity."""
    table, count = sweep.table, len(sweep)
    target = sweep.first("target_view")
    actions = float_columns(table, CONTROLS)
    views = table["view"].fill_null(-1).to_numpy()
    grades = float_columns(table, ["grade"])[:, 0]
    aim = None if target == labels[-1] else labels.index(target)  # a random scan has no target
    rewards, ended = judge_steps(views, grades, aim, declared="patient" in table.column_names)
    images, parameters = sweep.images().reshape(count, -1), float_columns(table, PARAMETERS)
    observations = {"image": _fixed(images), "params": _fixed(parameters)}
    if robot != FREE:
        observations["joints"] = _fixed(recorded_joints(parameters, robot))
    infos = {
        "view": pa.array(views),
        "grade": pa.array(grades),
        "timestamp": table["timestamp"].combine_chunks(),
        "frame": table["frame"].combine_chunks(),
    }
    if "patient" in table.column_names:
        infos |= {name: table[name].combine_chunks() for name in ("patient", *PHASES)}
    if (masks := sweep.masks()) is not None:
        infos["mask"] = _fixed(masks.reshape(count, -1))
    batch = pa.RecordBatch.from_pydict(
        {
            "observations": _struct(observations),
            "actions": _fixed(actions),  # the last one leads nowhere; Minari drops it
            "rewards": np.append(rewards, 0.0),
            "terminations": np.append(ended, False),
            "truncations": (np.arange(count) == count - 2) & ~np.append(ended, False),
            "infos": _struct(infos),
        }
    )
    folder = data / str(episode)
    folder.mkdir(parents=True)
    options = ipc.IpcWriteOptions(compression="zstd")
    with ipc.new_file(str(folder / "part-0.arrow"), batch.schema, options=options) as writer:
        writer.write_batch(batch)
    about = {"id": episode, "total_steps": count - 1, "split": sweep.split}
    named = "patient" if "patient" in table.column_names else "phantom"
    about |= {k: sweep.first(k) for k in ("trajectory", "session", "target_view", named)}
    (folder / "metadata.json").write_text(json.dumps(about), encoding="utf-8")
    return int(np.isnan(actions[:-1]).any(-1).sum())


def judge_steps(
    views: np.ndarray, grades: np.ndarray, target: int | None, declared: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return what T-1 steps pay and where they end the task.

    Args:
        views: (T,) the oracle's labels, -1 where unknown.
        grades: (T,) its grades of that view, 0-10, NaN where unknown.
        target: The label of the target view; None where there is none: nothing is paid or ended.
        declared: The task ends where an agent says so, which no recording does.

    Returns:
        (T-1,) float64 rewards and (T-1,) bool: the step completes the hits in a row that end an
        episode of the task. A run of hits ends it once.
    """
    if target is None:
        return np.zeros(len(views) - 1), np.zeros(len(views) - 1, bool)
    config, shown = RewardConfig(), torch.from_numpy(views == target)
    grade = torch.from_numpy(np.where(shown, grades, 0.0))
    score = Score(shown.double(), grade, torch.zeros(len(views)))
    before, after = (Score(*(each[rows] for each in score)) for rows in (slice(-1), slice(1, None)))
    streak, ended = 0, np.zeros(len(views) - 1, bool)
    for step, hit in enumerate(is_hit(after, config).tolist()):  # NaN is no hit
        streak = (streak + 1) * hit
        ended[step] = streak == Task.hits and not declared
    known = torch.from_numpy((views >= 0) & (~shown.numpy() | np.isfinite(grades)))
    paid = ORACLE(before, after, torch.from_numpy(ended), config)
    return torch.where(known[1:] & known[:-1], paid, 0.0).double().numpy(), ended


def env_spec(manifest: Mapping[str, Any], views: Sequence[str], robot: str = FREE) -> str | None:
    """Return the JSON of Gymnasium's spec of a dataset's task; None where there is none.

    The first of `views` that an organ registers is the target. There is none for recordings, nor
    for a phantom of another version: nobody could make that environment here.
    """
    try:
        phantom = recorded_phantom(dict(manifest))
    except RacinesError:
        return None
    kwargs: dict[str, Any] = {"observation": "multimodal", "reward": "oracle"}
    if robot != FREE:
        kwargs["robot"] = robot
    if phantom != PhantomConfig(anatomy=phantom.anatomy):
        kwargs["phantom"] = dataclasses.asdict(phantom)
    for view in views:
        name = task_id(view, phantom.anatomy)
        if name in gymnasium.registry:
            spec = gymnasium.spec(name)
            return dataclasses.replace(spec, kwargs={**spec.kwargs, **kwargs}).to_json()
    return None


def patients_spec(tier: str, split: str, views: Sequence[str], robot: str = FREE) -> str | None:
    """Return the spec of the task on patients at which most sweeps aim, on those of the split."""
    for view in views:
        name = task_id(view, tier=tier)
        if name in gymnasium.registry:
            spec = gymnasium.spec(name)
            own = {"observation": "multimodal", "reward": "oracle", "split": split}
            own |= {"robot": robot} if robot != FREE else {}
            return dataclasses.replace(spec, kwargs={**spec.kwargs, **own}).to_json()
    return None


def _fixed(values: np.ndarray) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _struct(columns: Mapping[str, pa.Array]) -> pa.StructArray:
    return pa.StructArray.from_arrays([*columns.values()], [*columns])


def _write_metadata(
    data: Path,
    name: str,
    manifest: Mapping[str, Any],
    counts: Mapping[str, int],
    spec: str | None,
    told: str,
    robot: str,
) -> None:
    image = _box((1, IMAGE_SIZE, IMAGE_SIZE), 0, 255, "uint8")
    params = _box((len(PARAMETERS),), -np.inf, np.inf, "float32")
    action = _box((len(CONTROLS),), -np.inf, np.inf, "float32")
    spaces = {"type": "Dict", "subspaces": {"image": image, "params": params}}
    if robot != FREE:
        spaces["subspaces"]["joints"] = _box((joint_count(robot),), -np.inf, np.inf, "float32")
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
        "author": [credited(maker_of(manifest))[0]],
        "algorithm_name": "recorded sweeps",
        "description": told,
        "racines": {key: manifest[key] for key in ("source", "version", "digest", "recipe_digest")}
        | rights_of(manifest),
    }
    if spec is not None:
        metadata["env_spec"] = spec
    (data / "metadata.json").write_text(json.dumps(metadata), encoding="utf-8")


def _description(manifest: Mapping[str, Any], config: str, robot: str) -> str:
    labels = _numbered(manifest_labels(manifest))
    if config in ADDED:
        task = f"racines/<target view>-{config}-v0"
        more = "; patient (a seed), cardiac_phase and respiratory_phase (0-1)"
        if masks := manifest["mask_labels"]:
            more += f", mask (128 rows of 128: {_numbered(masks)})"
    else:
        task, more = "racines/<target view>-v0", ""
    joints = "" if robot == FREE else f" joints: those of a {robot}, rad;"
    return (
        f"RACINES, {describe(manifest, config)}. "
        f"Observation: image (1, 128, 128), 8-bit gray, unchanged;{joints} "
        f"params: {', '.join(PARAMETERS)} (N, N·m, m, rad; robot base frame; NaN where unknown). "
        "Action: the commanded velocity at the frame before the step (m/s, rad/s; base frame). "
        f"Reward and termination: those of the task {task} with reward 'oracle', "
        f"by the recorded labels ({ORACLE.formula}; 0 where a label is unknown or the sweep has no "
        "target); the recording goes on after a termination. The last step of a sweep is a "
        f"truncation. Infos, one an observation: view ({labels}; -1 unknown), grade "
        f"(0-10; NaN unknown), timestamp (s), frame{more}. Research data, not for clinical use."
    )


def _numbered(names: Sequence[str]) -> str:
    return ", ".join(f"{index} {name}" for index, name in enumerate(names))


def _box(shape: tuple[int, ...], low: float, high: float, dtype: str) -> dict[str, Any]:
    bounds = {"low": np.full(shape, low).tolist(), "high": np.full(shape, high).tolist()}
    return {"type": "Box", "dtype": dtype, "shape": list(shape), **bounds}
