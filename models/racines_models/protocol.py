"""What a generator is: images of poses, fitted on a store, saved to a folder."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore


@dataclass(frozen=True)
class Run:
    """Where and how one fit runs; never what is fitted, which is the generator's config."""

    folder: Path
    """Receives the model, its metrics, and checkpoints while the fit is under way."""
    seed: int = 0
    device: str = "auto"
    """`cpu`, `cuda`, or `auto`: the accelerator if there is one."""
    resume: bool | None = None
    """True: continue a checkpoint, which must be there; False: start anew; None: as it comes."""
    progress: bool = True
    """Draw a progress bar on stderr."""


@dataclass(frozen=True)
class Card:
    """What a reader needs to know of a fitted generator; every text is filled in."""

    name: str
    title: str
    summary: str
    """One sentence: how an image comes to be."""
    source: str
    """Paper, section or rule that the method follows."""
    stochastic: bool
    """Whether the seed changes the image."""
    weights: int
    """Numbers stored in the model file."""
    data: dict[str, Any]
    """Source, version and digest of the training data."""
    config: dict[str, Any]
    seed: int
    limits: tuple[str, ...] = field(default=())
    """Known weaknesses, one sentence each."""


@runtime_checkable
class Generator(ImageSource, Protocol):
    """Makes images of poses after it has seen the training frames.

    `generate` (see `ImageSource`) is deterministic: the same parameters and seed give the same
    bytes to the last bit, whatever batch a sample stands in. A pose with NaN is refused with
    `RacinesError`; an absent force is not.
    """

    name: ClassVar[str]
    Config: ClassVar[type]
    """A dataclass whose defaults are usable, filled from the params section of this name."""

    def __init__(self, config: Any = None) -> None:
        """Take a `Config`, or its defaults."""
        ...

    @property
    def card(self) -> Card:
        """Describe the fitted generator."""
        ...

    def fit(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn from the train split, save into `run.folder`, and return the metrics."""
        ...

    def save(self, folder: Path) -> None:
        """Write `model.safetensors` and `config.json`."""
        ...

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> Self:
        """Read what `save` wrote.

        Raises:
            RacinesError: no model there, or one of another generator.
        """
        ...
