"""The test split of a simulated dataset drawn anew: the same recipe, another seed."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.build.writer import assign_splits
from racines_data.config import fill
from racines_data.digest import content_digest, trajectory_digest
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import check_split
from racines_data.phantom.acquisition import AcquisitionConfig
from racines_data.phantom.config import phantom_settings, recorded_phantom
from racines_data.phantom.model import shared_phantom
from racines_data.progress import progress_bar
from racines_data.records import PIXELS
from racines_data.schema import SPLITS, Trajectory
from racines_data.sources.phantom import PhantomSource, SweepUnit
from racines_data.store.frames import Batch, BatchMemory, FrameStore
from racines_leaderboard.fresh.rounds import Secret
from racines_models.sample import draw

COLUMNS = (
    ("parameters", np.float32),
    ("views", np.int64),
    ("grades", np.float32),
    ("timestamps", np.float64),
    ("controls", np.float32),
)
"""Of a trajectory and a store, under one name, beside the images."""


class FreshFrames(FrameStore):
    """Trajectories that no dataset holds, as one split of a store; the other splits are empty."""

    def __init__(self, public: FrameStore, split: str, trajectories: Sequence[Trajectory]) -> None:
        """Hold trajectories of the phantom that the `public` dataset was acquired from, whole."""
        lengths = [len(each) for each in trajectories]
        self.root, self.config, self.labels = public.root, public.config, public.labels
        rows = [(split, each.id, trajectory_digest(each)) for each in trajectories]
        self.manifest = public.manifest | {
            "digest": content_digest(rows, public.manifest["source"])
        }
        self.images = torch.from_numpy(np.concatenate([each.images for each in trajectories]))
        self._memory = BatchMemory()
        self._words = self.images.view(-1, PIXELS).view(torch.int64)
        assert self.images.shape[1:] == (IMAGE_SIZE, IMAGE_SIZE)
        for name, dtype in COLUMNS:
            parts = [np.asarray(getattr(each, name), dtype) for each in trajectories]
            setattr(self, name, torch.from_numpy(np.concatenate(parts)))
        numbers = torch.arange(len(lengths))
        self.trajectory_index = numbers.repeat_interleave(torch.tensor(lengths))
        self.frame = torch.cat([torch.arange(length) for length in lengths])
        self.trajectories = [each.id for each in trajectories]
        self.sessions = [each.session for each in trajectories]
        self.target_views = [each.target_view for each in trajectories]
        self.phantoms = [each.phantom for each in trajectories]
        self._splits = {each: [0, 0] for each in SPLITS} | {check_split(split): [0, sum(lengths)]}

    def __reduce__(self) -> Any:
        """Refuse to be pickled: what would be opened again is the public folder."""
        raise TypeError("fresh frames lie in memory alone")


class AllFrames(FrameStore):
    """A dataset without splits: what is asked of one is asked of all."""

    def split_indices(self, split: str) -> Tensor:
        """Return all (N,) rows."""
        return torch.arange(len(self))


def check_simulated(store: FrameStore) -> None:
    """Refuse a dataset that cannot be drawn again: recordings, or one of another phantom."""
    if phantom_settings(store.manifest, "frames") is None:
        raise RacinesError(
            f"{store.root}: source {store.manifest.get('source')}: recorded data cannot be drawn "
            "anew: fresh draws need a simulator; leave out --secret"
        )
    recorded_phantom(store.manifest)


def draw_frames(
    store: FrameStore, split: str, secret: Secret, workers: int = 1, progress: bool = False
) -> FreshFrames:
    """Acquire a split of a simulated dataset anew, as large and by the same recipe.

    The whole acquisition is planned with another seed and divided as the dataset was, so that
    views, lengths and operators of the split are distributed alike; what falls into it is scanned.

    Raises:
        RacinesError: recordings, another phantom's dataset, or a split of fewer than two
            trajectories, of which no interval is known.
    """
    check_simulated(store)
    recipe = store.manifest["recipe"]
    settings = recipe["settings"]["acquisition"] | {"seed": secret.seed("poses")}
    source = PhantomSource(fill(AcquisitionConfig, settings, "manifest.json: recipe: acquisition"))
    units, shares = source.plan(), recipe["splits"]
    splits = assign_splits(units, shares["validation"], shares["test"], secret.seed("splits"))
    chosen = [unit for unit in units if splits[unit.id] == split]
    if len(chosen) < 2:
        raise RacinesError(
            f"split {split}: {len(chosen)} trajectories: fresh draws need two or more"
        )
    trajectories = []
    with progress_bar(progress, "frames") as bar:
        task = bar.add_task("fresh frames", total=sum(unit.frames for unit in chosen))
        engine = LocalEngine(workers)
        for made in engine.map(_produce, source, chosen, remedy="with fewer workers"):
            trajectories.append(made)
            bar.advance(task, len(made))
    return FreshFrames(store, split, trajectories)


def _produce(source: PhantomSource, unit: SweepUnit) -> Trajectory:
    return source.produce(unit)


def scan_again(store: FrameStore, frames: Batch, seeds: Sequence[int]) -> list[Tensor]:
    """Return the (N, 128, 128) images of a phantom's frames scanned again, a set a seed."""
    phantom = shared_phantom(recorded_phantom(store.manifest), "cpu")
    return [draw(phantom, frames, seed) for seed in seeds]
