"""What a learner is fed, how fast it learns, and what is looked at on the way."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import torch

from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore
from racines_models.protocol import Run
from racines_models.training.feed import Feed
from racines_models.training.objective import Learner, TrainBatch, Training
from racines_models.training.schedule import rate_factor
from racines_models.training.validation import Validation


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


class FrameCourse(Course):
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
        self._learner, self._config = learner, config
        self._feed = Feed(store, config.batch_size, run.seed, device, share)
        self._validation = Validation(store, run.seed)

    def batches(self, start: int, stop: int) -> Iterator[TrainBatch]:
        """Yield this process's share of each batch."""
        return self._feed.batches(start, stop)

    def rate(self, step: int) -> float:
        """Return the factor that the config's schedule and warm-up say."""
        return rate_factor(self._config, step * self._config.batch_size)

    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Draw the validation frames, if it is images that the learner makes."""
        if not isinstance(self._learner, ImageSource):
            return {}
        drawn = self._validation.draw(self._learner)
        self._validation.grid(drawn, folder / "samples" / f"{seen:09d}.png")
        figures = self._validation.figures(drawn)
        return {f"validation/{key}": figures[key] for key in ("mae", "psnr")}
