"""The dataset by trajectory: which there are, and one of them frame by frame."""

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_data.manifest import MANIFEST, MULTI_PHANTOM, store_name
from racines_data.schema import SPLITS
from racines_data.store.frames import FrameStore, open_store
from racines_leaderboard.studio.inputs import choice, whole

ALL = "all"
LISTED = 500
"""Trajectories offered at a time; filters bring the others."""


@dataclass(frozen=True)
class Trajectory:
    """One trajectory of T frames."""

    store: FrameStore
    name: str
    target_view: str
    session: str
    split: str
    first: int
    """Row of its first frame."""
    frames: int

    @property
    def rows(self) -> slice:
        """Its rows of the store."""
        return slice(self.first, self.first + self.frames)

    @property
    def times(self) -> np.ndarray:
        """(T,) seconds since its first frame; frame numbers where the data have no time."""
        stamps = self.store.timestamps[self.rows].numpy()
        known = np.isfinite(stamps).all()
        return stamps - stamps[0] if known else np.arange(self.frames, dtype=np.float64)

    @property
    def timed(self) -> bool:
        """Whether the data have times."""
        return bool(torch.isfinite(self.store.timestamps[self.rows]).all())


def configs(root: Path | None) -> list[str]:
    """Return the configs of a dataset that can be browsed; none where there is no dataset."""
    if root is None or not (root / MANIFEST).is_file():
        return []
    return [name for name in ("frames", MULTI_PHANTOM) if (root / store_name(name)).is_file()]


def opened(root: Path | None, config: Any) -> FrameStore:
    """Open a config's store; the same one for everybody, until the dataset is built anew.

    Raises:
        RacinesError: no such config, or a damaged store.
    """
    config = choice(config, configs(root), "data")
    assert root is not None
    return _opened(root, config, (root / MANIFEST).stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _opened(root: Path, config: str, stamp: int) -> FrameStore:
    return open_store(root, config)


def trajectories(store: FrameStore, split: Any, view: Any) -> list[str]:
    """Return the first trajectories of a split, or of one target view of it, by name.

    Raises:
        RacinesError: a split or a view that was not offered.
    """
    split = choice(split, SPLITS, "split")
    view = choice(view, (ALL, *store.labels), "view")
    low, high = store.bounds(split)
    present = torch.unique_consecutive(store.trajectory_index[low:high]).tolist()
    fitting = [i for i in present if view in (ALL, store.target_views[i])]
    return [store.trajectories[i] for i in fitting[:LISTED]]


def trajectory(store: FrameStore, name: Any) -> Trajectory:
    """Return a trajectory by its name.

    Raises:
        RacinesError: no such trajectory.
    """
    name = choice(name, store.trajectories, "trajectory")
    index = store.trajectories.index(name)
    # Rows of a trajectory are neighbours, and lie in one split.
    rows = torch.nonzero(store.trajectory_index == index).flatten()
    if not len(rows):
        raise RacinesError(f"trajectory {name}: has no frames")
    first = int(rows[0])
    split = next(s for s in SPLITS if first in range(*store.bounds(s)))
    target, session = store.target_views[index], store.sessions[index]
    return Trajectory(store, name, target, session, split, first, len(rows))


def frame_of(chosen: Trajectory, frame: Any) -> int:
    """Return the place of a frame, 0 to T - 1, from its number on the page, 1 to T.

    Raises:
        RacinesError: no whole number, or beyond the trajectory.
    """
    return whole(frame, 1, chosen.frames, "frame") - 1
