"""Episodes: some patients a step, the scout of each, and poses of theirs to be drawn."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.patients.scouts import FRAMES, POSES
from racines_data.randomness import derive, uniform
from racines_data.store.frames import FrameStore
from racines_models.training.objective import Course, Training, rate_factor

WHO, WHAT, CHANCE = 41, 42, 43
"""Random streams: the patients of a step, the poses of each, the seeds of its samples."""
POSES_EACH = 8
"""Poses of a patient in a step."""
Look = Callable[[int, Path], Mapping[str, float]]


class Episode(NamedTuple):
    """One training step's data: B images of G patients, on the device."""

    cases: Tensor
    """(G,) places of the patients among the store's trajectories."""
    owner: Tensor
    """(B,) which of the G patients each image is of."""
    images: Tensor
    """(B, 128, 128) uint8."""
    parameters: Tensor
    """(B, 12) float32."""
    seeds: Tensor
    """(B,) int64: all randomness of the step comes from these."""


class EpisodeCourse(Course):
    """Draws patients and poses by chance, a function of seed and position alone."""

    def __init__(
        self, store: FrameStore, config: Training, seed: int, device: str, look: Look
    ) -> None:
        """Take a store of scouts (see `cases_of`); `look` is asked as `Course.look`.

        Raises:
            RacinesError: a batch that is no multiple of the poses of a patient.
        """
        if config.batch_size % POSES_EACH:
            raise RacinesError(
                f"training.batch_size {config.batch_size}: give a multiple of {POSES_EACH}, the "
                "poses of a patient in a step"
            )
        self._store, self._config, self._device = store, config, device
        self._cases, self._seed, self._look = cases_of(store, "train"), torch.tensor([seed]), look

    def batches(self, start: int, stop: int) -> Iterator[Episode]:
        """Yield the episodes of the steps from image `start` to image `stop`."""
        size = self._config.batch_size
        patients = size // POSES_EACH
        owner = torch.arange(patients).repeat_interleave(POSES_EACH)
        for position in range(start, stop, size):
            seed = derive(self._seed, position)
            cases = self._cases[(uniform(seed, patients, WHO)[0] * len(self._cases)).long()]
            order = uniform(derive(seed, torch.arange(patients)), POSES, WHAT).argsort(1)
            rows = cases.unsqueeze(1) * (FRAMES + POSES) + FRAMES + order[:, :POSES_EACH]
            frames = self._store.take(rows.flatten())
            seeds = derive(seed, CHANCE, torch.arange(size))
            columns = (cases, owner, frames.images, frames.parameters, seeds)
            yield Episode(*(column.to(self._device) for column in columns))

    def rate(self, step: int) -> float:
        """Return the factor that the config's schedule and warm-up say."""
        return rate_factor(self._config, step * self._config.batch_size)

    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Look at the averaged networks."""
        return self._look(seen, folder)


def cases_of(store: FrameStore, split: str) -> Tensor:
    """Return the (P,) trajectories of a split of a store of scouts.

    Raises:
        RacinesError: a store of anything else.
    """
    if store.config != "scouts":
        raise RacinesError(
            f"config {store.config!r} has no scouts to learn from: train with --tier patients"
        )
    return store.trajectory_index[store.split_indices(split)].unique()


def scouts_of(store: FrameStore, cases: Tensor) -> tuple[Tensor, Tensor]:
    """Return (G, 64, 128, 128) images and (G, 64, 12) parameters of the scouts of (G,) cases."""
    rows = cases.unsqueeze(1) * (FRAMES + POSES) + torch.arange(FRAMES)
    frames = store.take(rows.flatten())
    images, parameters = (x.unflatten(0, rows.shape) for x in (frames.images, frames.parameters))
    return images, parameters


def asked_of(store: FrameStore, case: int) -> tuple[Tensor, Tensor]:
    """Return the (32, 128, 128) images and (32, 12) parameters that are asked for of a case."""
    rows = case * (FRAMES + POSES) + FRAMES + torch.arange(POSES)
    frames = store.take(rows)
    return frames.images, frames.parameters
