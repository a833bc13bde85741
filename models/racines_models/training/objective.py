"""What the trainer asks of a learner, what it feeds it, and what is looked at on the way."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.pictures import write_strip
from racines_models.protocol import Run
from racines_models.sample import evenly

ORDER, NOISE = 11, 12
"""Random streams: the order of an epoch, the seeds of a step's samples."""
FRAMES, COLUMNS = 64, 8
"""Validation frames judged, and those drawn in a grid."""


@dataclass(frozen=True)
class Training:
    """The loop's settings, the same for all that is trained."""

    images: int = 24_000
    """Budget: training images seen, counted with repetition."""
    batch_size: int = 16
    """Images a step, over all processes together."""
    precision: str = "auto"
    """`fp32`; mixed `bf16` or `fp16`; or `auto`: bf16 where the processor has units for it (CUDA;
    AMX on a CPU, 1.8 times the images a second), else fp32."""
    compile: bool = field(default=False, kw_only=True)
    """Compile the networks' passes with `torch.compile`; on a CPU this needs a C++ compiler."""
    ema: float = 0.999
    """Decay of the averaged weights that draw and are saved, warmed up; 0 switches it off."""
    gradient_clip: float = 0.0
    """Largest gradient norm of a network's step; 0 clips nothing."""
    schedule: str = "constant"
    """Of all learning rates, after the warm-up: `constant`, or `cosine` down to 0 at the end."""
    warmup_images: int = 0
    """Images over which the learning rates rise linearly from 0."""
    repeats: int = 1
    """Seeds trained one after the other, from the run's own on; scores are means over them."""
    log_every: int = 1_000
    """Images between two rows of the loss curves."""
    sample_every: int = 6_000
    """Images between two sample grids with validation figures."""
    checkpoint_every: int = 6_000
    """Images between two checkpoints."""

    def __post_init__(self) -> None:
        if min(self.images, self.log_every, self.sample_every, self.checkpoint_every) < 1:
            raise RacinesError("training: images and the intervals are at least 1")
        if self.repeats < 1:
            raise RacinesError("training.repeats: 1 or more")
        if self.batch_size < 2:
            raise RacinesError("training.batch_size: batch norm needs at least 2")
        if self.precision not in ("auto", "fp32", "bf16", "fp16"):
            known = "auto, fp32, bf16 or fp16"
            raise RacinesError(f"training.precision: {self.precision!r}: use {known}")
        if self.schedule not in ("constant", "cosine"):
            raise RacinesError(f"training.schedule: {self.schedule!r}: use constant or cosine")
        if not 0 <= self.warmup_images < self.images:
            raise RacinesError("training.warmup_images: 0 or more, and fewer than images")
        if not 0.0 <= self.ema < 1.0:
            raise RacinesError("training.ema: a decay lies in [0, 1)")

    @property
    def stop(self) -> int:
        """The budget in whole batches."""
        return -(-self.images // self.batch_size) * self.batch_size


class TrainBatch(NamedTuple):
    """One training step's data, on the device."""

    images: Tensor
    """(B, 128, 128) uint8."""
    parameters: Tensor
    """(B, 12) float32; forces may be NaN."""
    seeds: Tensor
    """(B,) int64: all randomness of the step comes from these, so a resumed run repeats it."""


class Update(NamedTuple):
    """One optimizer step that the trainer is asked to make."""

    optimizer: str
    loss: Tensor
    logged: Mapping[str, Tensor]
    """Scalars for the curves."""


class Learner(Protocol):
    """Whatever the trainer can train."""

    @property
    def name(self) -> str:
        """What the curves and messages call it."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """Say what is trained on what; only an equal run is continued."""
        ...

    def modules(self) -> dict[str, nn.Module]:
        """Return the networks by name; fixed once training starts."""
        ...

    def averaged(self) -> tuple[str, ...]:
        """Name the networks that are used afterwards: their weights are averaged (EMA)."""
        ...

    def optimizers(self) -> dict[str, Optimizer]:
        """Return fresh optimizers by name."""
        ...

    def updates(self, nets: Mapping[str, nn.Module], batch: Any) -> Iterator[Update]:
        """Yield the optimizer steps of one batch, in order.

        `nets` are the networks of `modules`, as the accelerator wraps them. The trainer makes each
        step before it asks for the next, so a later loss sees the stepped weights; gradients are
        cleared in between. `batch` is a `TrainBatch`, or what the learner's own course feeds.
        """
        ...


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

    def rows(self, start: int, stop: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield the (B,) rows and (B,) seeds of each step, whole batches on the CPU."""
        for position in range(start, stop, self._batch_size):
            index = self._indices(position)
            yield index, derive(self._seed, NOISE, torch.arange(len(index)) + position)

    def batches(self, start: int, stop: int) -> Iterator[TrainBatch]:
        """Yield batches from image `start` of the stream until `stop` images have been seen."""
        for index, seeds in self.rows(start, stop):
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
