# pyright: strict
"""What a generator is: images of poses, fitted on a store; and what judges images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource

if TYPE_CHECKING:
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
    limits: tuple[str, ...] = ()
    """Known weaknesses, one sentence each."""
    conditional: bool = True
    """Whether the pose changes the image."""
    trained: bool = True
    """Whether it learns by random draws, so that another training of it ends elsewhere."""
    adapts: bool = False
    """Whether it adapts to a patient's scout (see `Adapting`); else it ignores who is scanned."""


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

    @property
    def card(self) -> Card:
        """Describe the fitted generator."""
        ...

    def fit(self, store: "FrameStore", run: Run) -> dict[str, Any]:
        """Learn from the train split, save into `run.folder`, and return the metrics."""
        ...

    def save(self, folder: Path) -> None:
        """Write `model.safetensors` and `config.json`."""
        ...

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> Self:
        """Read what `save` wrote; a `RacinesError` says that there is no such model."""
        ...


@runtime_checkable
class Adapting(Protocol):
    """What a generator has besides, if it can meet a patient whom it has never seen."""

    scout: ClassVar[int]
    """Fewest frames of a scout that it can adapt to."""

    def adapt(self, images: Tensor, parameters: Tensor, seed: int) -> ImageSource:
        """Return the generator adapted to one patient; this one stays as it is.

        Args:
            images: (S, 128, 128) uint8 frames of a sweep over the patient.
            parameters: (S, 12) of the probe in these frames, as `schema.PARAMETERS`.
            seed: of all chance in adapting; the same scout and seed give the same images.

        Raises:
            RacinesError: fewer frames than `scout`, or frames that cannot be used.
        """
        ...


@runtime_checkable
class Judge(Protocol):
    """Says of an image which view it shows and how well; a trained grader, or a class of your own.

    What inherits it gives `probabilities_and_grade`, and may leave the rest as it is.
    """

    labels: tuple[str, ...] = ()
    """Names of the labels in the order of the probabilities, `Random` last; empty if untold."""
    sha256: str | None = None
    """Hash of the weights, if there are any."""

    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) probabilities and (B,) grades 0-10 of (B, 128, 128) uint8 images."""
        ...

    @property
    def settings(self) -> dict[str, Any] | None:
        """What its answers depend on, as a scores file names it; None if untold."""
        return None

    def check_labels(self, labels: Sequence[str], what: str) -> None:
        """Refuse other labels, those of `what`, than it was trained for, if it tells which."""
        if self.labels and self.labels != tuple(labels):
            raise RacinesError(
                f"the grader knows {', '.join(self.labels)}, {what} has {', '.join(labels)}: train "
                "a grader on a dataset of that anatomy: racines train grader"
            )
