"""Sweeps with poses, of any dataset: the images that an estimator is shown, and what is true.

Simulated patients, tracked sweeps and the phantom alike: a trajectory is a sweep. Turns about an
apex are recorded one pose a trajectory, all phases of the beat at each; there a sweep is a split's
turns, or all turns, in the order of the file, at one phase:

    frames of turns     0.0 0.1 0.2 | 1.0 1.1 1.2 | 4.0 4.1 4.2        TURN.PHASE
    sweeps              (0.0 1.0 4.0) (0.1 1.1 4.1) (0.2 1.2 4.2)

Poses that were not recorded cannot be judged, and a probe that rests has no motion to estimate:
such sweeps are left out and counted.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.manifest import scale_known
from racines_data.schema import SPLITS
from racines_data.store.frames import FrameStore
from racines_models.provenance import dataset_card, sha256_bytes
from racines_models.trackerless.motion import Motion, relative, to_vectors
from racines_models.trackerless.planes import Plane, planes_of

EVERY = "all"
"""Stands for the three splits together: of recordings that nothing was learned from."""


@dataclass(frozen=True)
class Shown:
    """What an estimator is shown of a sweep."""

    images: Tensor
    """(T, 128, 128) uint8."""
    timestamps: Tensor
    """(T,) float64 s, NaN where unknown."""
    first: Tensor | None = None
    """(4, 4) the true transform of frame 1 to frame 0, m, for who says that it is told it."""


@dataclass(frozen=True)
class Sweep:
    """One sweep of T frames."""

    id: str
    rows: Tensor
    """(T,) of the store."""
    number: int
    """Its trajectory's place in the store; of a sweep over turns, its first row."""
    unit: int
    """What was drawn independently: the patient, the recording, or the trajectory."""
    pose: Pose
    """(T,) float64."""
    plane: Plane | None
    """Where its pixels lie; None where nobody knows."""

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def motion(self) -> Motion:
        """The true motion."""
        return relative(self.pose)


class SweepSet:
    """The sweeps of a dataset's splits."""

    def __init__(self, store: FrameStore) -> None:
        """Take the sweeps of a store.

        Raises:
            RacinesError: no sweep has all its poses and a probe that moves.
        """
        self.store, self.card = store, dataset_card(store) | {"config": store.config}
        self.metric = scale_known(store.manifest)
        """Whether positions are metres."""
        self._units = _units(store)
        pose = parameters_to_pose(store.parameters.double())
        self._pose = pose
        numbers = torch.cat([pose.position, pose.rotation.flatten(1)], 1)

        def moves(rows: Tensor) -> bool:
            own = numbers[rows]
            return bool(own.isfinite().all()) and bool((own[1:] != own[:1]).any())

        self.left_out: dict[str, int] = {}
        """Sweeps of each split, and of `all`, that lack a pose, or whose probe rests."""
        self._rows: dict[str, list[Tensor]] = {}
        for split in SPLITS:
            every = _by_trajectory(store, split) if store.turns is None else _by_phase(store, split)
            kept = [each for each in every if moves(each)]
            self._rows[split], self.left_out[split] = kept, len(every) - len(kept)
        self.left_out[EVERY] = sum(self.left_out.values())
        if store.turns is not None:  # a split breaks their order
            every = _by_phase(store, *SPLITS)
            kept = [each for each in every if moves(each)]
            self._rows[EVERY], self.left_out[EVERY] = kept, len(every) - len(kept)
        if not any(self._rows.values()):
            raise RacinesError(
                f"{store.root}: config {store.config} has no sweep whose frames all have poses and "
                "whose probe moves: choose data such as patients or tracked sweeps"
            )

    def count(self, split: str) -> int:
        """Return the number of sweeps of a split, or of `all`."""
        return sum(len(self._rows[name]) for name in self._parts(split))

    def _parts(self, split: str) -> tuple[str, ...]:
        """Return under which names the sweeps of a split are kept."""
        return (split,) if split in self._rows else SPLITS

    def units(self, rows: Tensor) -> np.ndarray:
        """Return what each of (N,) rows was drawn independently with."""
        return self._units[self.store.trajectory_index[rows].numpy()]

    def rows(self, split: str) -> list[Tensor]:
        """Return the (T,) rows of each sweep of a split, or of `all`, in order of the store.

        Raises:
            RacinesError: an unknown split, or one without a sweep.
        """
        if split != EVERY and split not in SPLITS:
            raise RacinesError(
                f"unknown split {split!r}: choose one of {', '.join(SPLITS)} or {EVERY}"
            )
        found = [each for name in self._parts(split) for each in self._rows[name]]
        if not found:
            raise RacinesError(
                f"{self.store.root}: split {split} has no sweep with poses: choose another --split"
            )
        return found

    def sweeps(self, split: str) -> list[Sweep]:
        """Return the sweeps of a split; raises as `rows`."""
        found = []
        for rows in self.rows(split):
            trajectory = int(self.store.trajectory_index[rows[0]])
            name, number = self.store.trajectories[trajectory], trajectory
            if self.store.turns is not None:
                name, number = f"{name}-phase-{int(self.store.frame[rows[0]])}", int(rows[0])
            planes = planes_of(self.store, rows[:1]) if self.metric else None
            pose = Pose(self._pose.position[rows], self._pose.rotation[rows])
            unit = int(self._units[trajectory])
            plane = None if planes is None else planes[0]
            found.append(Sweep(name, rows, number, unit, pose, plane))
        return found

    def shown(self, sweep: Sweep, told_first: bool = False) -> Shown:
        """Return what an estimator is shown of a sweep."""
        first = sweep.motion.to_previous[1] if told_first else None
        images = self.store.take(sweep.rows).images
        return Shown(images, self.store.timestamps[sweep.rows], first)

    def steps(self, split: str) -> tuple[Tensor, Tensor]:
        """Return the (N,) rows of all frames but the first ones of a split, and (N, 6) motions.

        These are from the frame before in the sweep: m and rad, float64.
        """
        sweeps = self.sweeps(split)
        motions = torch.cat([to_vectors(each.motion.to_previous[1:]) for each in sweeps])
        return torch.cat([each.rows[1:] for each in sweeps]), motions


def digest_of(sweeps: list[Sweep]) -> str:
    """Return the sha256 of which frames are asked for."""
    return sha256_bytes(*(each.rows.numpy().tobytes() for each in sweeps))


def _by_trajectory(store: FrameStore, split: str) -> list[Tensor]:
    """Return the rows of each trajectory of a split; they are in order of their frames."""
    rows = store.split_indices(split)
    if not len(rows):
        return []
    counts = store.trajectory_index[rows].unique_consecutive(return_counts=True)[1]
    return list(rows.split(counts.tolist()))


def _by_phase(store: FrameStore, *splits: str) -> list[Tensor]:
    """Return the rows of the turns of splits at each phase, recording by recording."""
    rows = torch.cat([torch.as_tensor(store.split_indices(split)) for split in splits])
    found: dict[tuple[str, int], list[int]] = {}
    for row, frame in zip(rows.tolist(), store.frame[rows].tolist(), strict=True):
        session = store.sessions[int(store.trajectory_index[row])]
        found.setdefault((session, frame), []).append(row)

    def place(row: int) -> tuple[int, str]:
        """Put a turn by its number in the file, with which its name ends."""
        name = store.trajectories[int(store.trajectory_index[row])]
        return len(name), name

    return [torch.tensor(sorted(each, key=place)) for each in found.values()]


def _units(store: FrameStore) -> np.ndarray:
    """Return the unit of each trajectory: its patient or, of recordings, its session.

    Segments of one recording are no independent sweeps.
    """
    if store.patients is not None:
        return np.array(store.patients)
    if any(each is not None for each in store.phantoms):
        return np.arange(len(store.trajectories))
    names: list[Any] = store.sessions
    return np.unique(names, return_inverse=True)[1]
