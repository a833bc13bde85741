"""Endless shuffled training batches that can start at any image."""

from collections.abc import Iterator

import torch
from torch import Tensor

from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.training.objective import TrainBatch

ORDER, NOISE = 11, 12
"""Random streams: the order of an epoch, the seeds of a step's samples."""


class Feed:
    """The train split as one endless stream: a fresh permutation an epoch, no batch cut short.

    Order and seeds are functions of (seed, position), so a resumed run needs no saved state.
    `share` is the part of each batch that this process takes; None takes all of it.
    """

    def __init__(
        self,
        store: FrameStore,
        batch_size: int,
        seed: int,
        device: torch.device | str,
        share: slice | None = None,
    ):
        self._store = store
        self._frames = store.split_indices("train")
        self._batch_size = batch_size
        self._seed = torch.tensor(seed)
        self._device = device
        self._share = share or slice(None)
        self._epoch: tuple[int, Tensor] = (-1, self._frames)

    def _permutation(self, epoch: int) -> Tensor:
        if self._epoch[0] != epoch:
            generator = torch.Generator().manual_seed(int(derive(self._seed, ORDER, epoch)))
            order = torch.randperm(len(self._frames), generator=generator)
            self._epoch = (epoch, self._frames[order])
        return self._epoch[1]

    def _indices(self, position: int) -> Tensor:
        parts, wanted = [], self._batch_size
        while wanted:
            epoch, offset = divmod(position, len(self._frames))
            parts.append(self._permutation(epoch)[offset : offset + wanted])
            wanted -= len(parts[-1])
            position += len(parts[-1])
        return torch.cat(parts)

    def batches(self, start: int, stop: int) -> Iterator[TrainBatch]:
        """Yield batches from image `start` of the stream until `stop` images have been seen."""
        for position in range(start, stop, self._batch_size):
            index = self._indices(position)
            seeds = derive(self._seed, NOISE, torch.arange(len(index)) + position)
            index, seeds = index[self._share], seeds[self._share]
            frames = self._store.take(index)
            columns = (frames.images, frames.parameters, seeds)
            yield TrainBatch(*(column.to(self._device) for column in columns))
