"""What a learner is fed, how fast it learns, and what is looked at on the way."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from racines_data.imaging import ImageSource
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.pictures import write_strip
from racines_models.protocol import Run
from racines_models.sample import evenly
from racines_models.training.objective import Learner, TrainBatch, Training

ORDER, NOISE = 11, 12
"""Random streams: the order of an epoch, the seeds of a step's samples."""
FRAMES, COLUMNS = 64, 8
"""Validation frames judged, and those drawn in a grid."""


class Course(Protocol):
    """How one kind of training goes; a learner with examples of its own is its own course."""

    def batches(self, start: int, stop: int) -> Iterator[Any]:
        """Yield the batches of the steps from image `start` to image `stop`, on the device."""
        ...

    def rate(self, step: int) -> float:
        """Return the factor of all learning rates in a step, counted from 0."""
        ...

    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Look at the averaged networks, in evaluation mode; return figures for the curves.

        Called every `Training.sample_every` images.
        """
        return {}

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint has to hold beside networks and optimizers."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""


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
        self._store, self._batch_size, self._device = store, batch_size, device
        self._frames = store.split_indices("train")
        self._seed = torch.tensor(seed)
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
            frames = self._store.take(index[self._share])
            columns = (frames.images, frames.parameters, seeds[self._share])
            yield TrainBatch(*(column.to(self._device) for column in columns))


class Validation:
    """Some frames of the validation split, evenly spread (of train, where that split is empty).

    A quick look at a generator while it trains; the published scores are made elsewhere.
    """

    def __init__(self, store: FrameStore, seed: int):
        frames = store.split_indices("validation")
        self._split = "validation" if len(frames) else "train"
        frames = store.split_indices(self._split).sort().values
        frames = frames[evenly(len(frames), FRAMES)]
        self._truth, self._parameters, *_ = store.take(frames)
        self._seed = seed

    def look(self, generator: ImageSource, path: Path) -> dict[str, Any]:
        """Draw the frames' parameters; write a PNG, the truth above and the drawn images below.

        Returns:
            The split, n, mean absolute error in gray levels, and mean PSNR over frames in dB.
        """
        drawn = generator.generate(self._parameters, self._seed)
        chosen = evenly(len(drawn), COLUMNS)
        write_strip(path, [self._truth[chosen], drawn[chosen]], gap=0)
        error = drawn.double() - self._truth.double()
        power = error.square().mean((1, 2)).clamp_min(1e-3)
        psnr = (10.0 * torch.log10(255.0**2 / power)).mean()
        mae = float(error.abs().mean())
        return {"split": self._split, "n": len(drawn), "mae": mae, "psnr": float(psnr)}


def rate_factor(config: Training, seen: int) -> float:
    """Return the scale of the learning rates in the step that starts after `seen` images.

    Warm-up rises linearly to 1; `cosine` then falls to 0 at the end of the budget
    (Loshchilov and Hutter, SGDR, 2017, without restarts).
    """
    if seen < config.warmup_images:
        return min(1.0, (seen + config.batch_size) / config.warmup_images)
    if config.schedule == "constant":
        return 1.0
    past = (seen - config.warmup_images) / max(config.stop - config.warmup_images, 1)
    return 0.5 * (1.0 + math.cos(math.pi * past))


class FrameCourse(Feed, Course):
    """The train split by a `Training`'s schedule; what makes images draws validation frames."""

    def __init__(
        self,
        learner: Learner,
        store: FrameStore,
        config: Training,
        run: Run,
        device: torch.device,
        share: slice,
    ):
        super().__init__(store, config.batch_size, run.seed, device, share)
        self._learner, self._config = learner, config
        self._validation = Validation(store, run.seed)

    def rate(self, step: int) -> float:
        """Return the factor that the config's schedule and warm-up say."""
        return rate_factor(self._config, step * self._config.batch_size)

    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Draw the validation frames, if it is images that the learner makes."""
        if not isinstance(self._learner, ImageSource):
            return {}
        figures = self._validation.look(self._learner, folder / "samples" / f"{seen:09d}.png")
        return {f"validation/{key}": figures[key] for key in ("mae", "psnr")}
