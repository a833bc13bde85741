"""A finished dataset on the sheet of an import: where its frames were taken, and what is wrong.

A turn about the apex has one pose, so there the frames of one phase are a sweep, by their angles.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import torch

from racines_data.geometry import parameters_to_pose
from racines_data.manifest import is_turned, scale_known
from racines_data.plotting import evenly
from racines_data.sources.table.inspecting import SHOWN, Inspection
from racines_data.sources.table.sweeps import Draft
from racines_data.store.frames import FrameStore
from racines_data.validate.run import validate


@dataclass
class Finished(Inspection):
    """What a dataset holds."""

    held: int = 0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.held


def inspect_dataset(root: Path, workers: int = 1) -> Finished:
    """Return where a dataset's frames were taken, some of them, and what `validate` finds.

    Args:
        root: folder of the dataset.
        workers: processes that check its files.

    Raises:
        RacinesError: it cannot be read at all.
    """
    found = validate(root, None, workers, progress=False)
    wrong = [f"{x.name}: {x.detail}" for x in found.checks if x.binding and not x.ok]
    store = FrameStore(root)
    named = _sweeps(store)
    poses, drafts = _poses(store), []
    for name, rows in named.items():
        times = store.timestamps[rows].double().numpy()
        drafts.append(Draft(name, name, root, pl.DataFrame(), rows, times, poses[rows]))
    unit = "mm" if scale_known(store.manifest) else "pixels"
    held = len(store.images)
    made = Finished(
        drafts, [each.poses for each in drafts], [], refused=wrong, unit=unit, held=held
    )
    first = drafts[0].rows[evenly(len(drafts[0].rows), SHOWN)]
    made.images = [(_title(store, row), store.images[row].numpy()) for row in first.tolist()]
    return made


def _sweeps(store: FrameStore) -> dict[str, np.ndarray]:
    """Return rows of the store by the name of their sweep, the longest first."""
    if is_turned(store.manifest) and store.turns is not None and store.phases is not None:
        order = torch.argsort(store.turns[:, 0], stable=True)
        phases = torch.nan_to_num(store.phases[:, 0]).round(decimals=6)[order]
        groups = {f"phase {each:.2f}": order[phases == each] for each in phases.unique().tolist()}
    else:
        which = store.trajectory_index
        groups = {name: (which == k).nonzero()[:, 0] for k, name in enumerate(store.trajectories)}
    longest = sorted(groups.items(), key=lambda each: -len(each[1]))
    return {name: rows.numpy() for name, rows in longest if len(rows)}


def _poses(store: FrameStore) -> np.ndarray:
    """Return (N, 4, 4) poses, metres; thousandths of a pixel where the scale is unknown."""
    pose = parameters_to_pose(store.parameters.double())
    poses = np.tile(np.eye(4), (len(store.images), 1, 1))
    poses[:, :3, :3] = pose.rotation.numpy()
    poses[:, :3, 3] = pose.position.numpy() * (1.0 if scale_known(store.manifest) else 1e-3)
    return poses


def _title(store: FrameStore, row: int) -> str:
    if is_turned(store.manifest) and store.turns is not None:
        return f"{store.turns[row, 0]:.1f}°"
    return f"{store.timestamps[row]:.2f} s"
