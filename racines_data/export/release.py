"""Any RACINES dataset in the layout of the published recordings, for other people's loaders.

    Folder 1/A4C/images/img<N>.png      Folder 1/A4C/logs/PA_<N>.txt
    Folder 1/SC/images_1/…  images_2/…  Folder 1/SC/logs_1/…  logs_2/…

A session is a folder, in natural order of their names; a trajectory is an image folder, numbered
where a session has several of one target view; `Random` is `Full`. N is the row's `frame`, from 0.
PNGs are those of the shards, byte for byte. The layout has no place for views, grades and splits.
Licence, consent and origin stand in `RIGHTS.txt` at the top, which loaders of the layout pass over.
"""

import hashlib
import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch

from racines_data.digest import checked_shards
from racines_data.errors import RacinesError
from racines_data.escape import visible
from racines_data.files import write_atomic
from racines_data.geometry import parameters_to_pose
from racines_data.manifest import UNKNOWN_SCALE, read_manifest
from racines_data.progress import progress_bar
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.sources.base import manifest_card, rights_of
from racines_data.sources.release import layout
from racines_data.store.sweeps import Sweep, new_folder, read_sweeps
from racines_data.views import RANDOM, check_labels

_KNOWN_FOLDERS = 3


class _Place(NamedTuple):
    """Where a trajectory of so many frames goes."""

    frames: int
    folder: str
    """Such as `Folder 1/A4C`."""
    suffix: str
    """Of its two folders: `_2`, or nothing."""


def export(
    root: Path,
    out: Path,
    split: str | None = None,
    limit: int | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Write a dataset in the published layout; an export that was killed goes on where it stopped.

    Arguments and errors as of `registry.Exporter`, and an error where there are no poses in metres
    or no times. Returns `out`, counts of frames and trajectories, and which session became which
    folder.
    """
    if out.exists():
        raise RacinesError(f"{out}: exists; name a new folder or remove it")
    manifest = read_manifest(root)
    if manifest.get("scale") == UNKNOWN_SCALE:
        raise RacinesError(
            f"{root}: positions are in pixels, and the published layout has metres: import it "
            "again with --pixel-mm"
        )
    shards = chain.from_iterable(checked_shards(root, manifest, "frames", split).values())
    places, sessions = _plan([root / name for name in shards], limit)
    key = hashlib.sha256(f"{manifest['digest']}/{split}/{limit}".encode()).hexdigest()[:16]
    staging = out.parent / f".{out.name}.{key}.part"
    staging.mkdir(parents=True, exist_ok=True)
    total = sum(place.frames for place in places.values())
    with progress_bar(progress) as bar:
        task = bar.add_task("frames", total=total)
        for sweep in read_sweeps(root, split, limit):
            _write_sweep(staging, places[sweep.id], sweep)
            bar.advance(task, len(sweep))
    write_atomic(staging / layout.RIGHTS, _rights(manifest))
    os.replace(staging, out)
    return {
        "out": str(out),
        "format": "release",
        "frames": total,
        "trajectories": len(places),
        "sessions": sessions,
        "notes": _notes(manifest, len(sessions)),
    }


def _notes(manifest: Mapping[str, Any], sessions: int) -> list[str]:
    """Return what to say of an export; of the rights where a dataset has a card of its own."""
    known = "a loader that knows only `Folder 1` to `Folder 3` will not see the others"
    notes = [f"{sessions} sessions: {known}"] if sessions > _KNOWN_FOLDERS else []
    if manifest.get("card"):
        told = rights_of(manifest)
        notes.append(f"licence: {told['rights']}")
        notes.append(f"made by: {told['attribution']}")
        notes.append(f"{layout.RIGHTS} says both, and consent: hand it on with the tree")
    return notes


def _rights(manifest: Mapping[str, Any]) -> str:
    """Return the text of `RIGHTS.txt`: licence, consent and origin as on the card, a line each.

    A line break in a statement would begin another one: what is not seen becomes a space.
    """
    told, card = rights_of(manifest), manifest_card(manifest)
    lines = {
        "Dataset": f"{manifest['source']} {manifest['version']}, content {manifest['digest']}",
        "Licence": f"{told['license']}. {told['rights']}",
        "Consent": told["personal"],
        "Made by": told["attribution"],
        "Origin": f"{card.origin}. {card.collection}",
    }
    return "".join(f"{name}: {visible(text)}\n" for name, text in lines.items())


def _plan(shards: Sequence[Path], limit: int | None) -> tuple[dict[str, _Place], dict[str, str]]:
    """Say what goes where: the place of each trajectory id, and the folder of each session."""
    columns = ["session", "target_view", "trajectory"]
    table = pa.concat_tables([pq.read_table(path, columns=columns) for path in shards])
    rows = table.slice(0, limit).to_pydict()
    counts = Counter(zip(*(rows[name] for name in columns), strict=True))
    if not counts:
        raise RacinesError(f"limit {limit}: nothing to export; give one frame or more")
    check_labels([view for _, view, _ in counts], "target_view")
    sessions = sorted({session for session, _, _ in counts}, key=layout.natural)
    folders = {name: f"Folder {number}" for number, name in enumerate(sessions, start=1)}
    members: dict[tuple[str, str], list[str]] = defaultdict(list)
    for session, view, trajectory in sorted(counts, key=lambda row: layout.natural(row[2])):
        members[session, view].append(trajectory)
    places = {}
    for (session, view, trajectory), frames in counts.items():
        folder = f"{folders[session]}/{layout.FULL if view == RANDOM else view}"
        others = members[session, view]
        suffix = f"_{others.index(trajectory) + 1}" if len(others) > 1 else ""
        places[trajectory] = _Place(frames, folder, suffix)
    return places, folders


def _write_sweep(staging: Path, place: _Place, sweep: Sweep) -> None:
    """Write the two folders of a trajectory, unless an earlier run has."""
    images, logs = (staging / place.folder / f"{side}{place.suffix}" for side in ("images", "logs"))
    if images.is_dir():
        return
    numbers, rows = sweep.table["frame"].to_pylist(), _log_rows(sweep.table)
    # The images come last: where they are, the trajectory is whole.
    shutil.rmtree(logs, ignore_errors=True)
    with new_folder(logs) as aside:
        for number, row in zip(numbers, rows, strict=True):
            (aside / f"PA_{number}.txt").write_text(layout.format_log(row), encoding="utf-8")
    with new_folder(images) as aside:
        for number, png in zip(numbers, sweep.pngs(), strict=True):
            (aside / f"img{number}.png").write_bytes(png)


def _log_rows(table: pa.Table) -> np.ndarray:
    """Return (T, 29) numbers of the logs of a trajectory; refuse one without poses."""
    parameters = float_columns(table, PARAMETERS).astype(np.float64)
    if not np.isfinite(parameters[:, 6:]).all():
        name = table["trajectory"][0].as_py()
        raise RacinesError(f"trajectory {name}: has no poses, which the published layout needs")
    if not np.isfinite(table["timestamp"].to_numpy()).all():
        name = table["trajectory"][0].as_py()
        raise RacinesError(f"trajectory {name}: has no times, which the published layout needs")
    pose = parameters_to_pose(torch.from_numpy(parameters))
    matrices = np.tile(np.eye(4), (len(table), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = pose.rotation.numpy(), pose.position.numpy()
    rows = np.empty((len(table), layout.WIDTH))
    rows[:, layout.TIME] = table["timestamp"].to_numpy()
    rows[:, layout.WRENCH] = parameters[:, :6]
    rows[:, layout.POSE] = matrices.reshape(len(table), 16)
    rows[:, layout.CONTROL] = float_columns(table, CONTROLS)
    return rows
