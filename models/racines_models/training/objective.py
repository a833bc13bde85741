"""What the trainer asks of a learner: networks, optimizers, and losses in order."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from torch import Tensor, nn
from torch.optim import Optimizer

from racines_data.errors import RacinesError


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
        """Refuse settings that cannot train."""
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
