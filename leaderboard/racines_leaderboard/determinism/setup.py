"""Where a stage runs: threads, batch, workers, device; and what all stages share."""

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from racines_data.config import fill, section

if TYPE_CHECKING:
    from racines_data.store.frames import FrameStore

Arrays = dict[str, Tensor]
POSES = 64
FRAMES = 240
"""Of the dataset that is built for the report."""
SETTINGS: dict[str, Any] = {
    "data": {"frames": FRAMES, "workers": 1, "phantom": {"shortest": 10, "longest": 20}},
    "grader": {"input_size": 32, "view_stage": {"epochs": 1}, "grade_stage": {"epochs": 1}},
}
TRAINING: dict[str, Any] = {"images": 24, "batch_size": 8, "ema": 0.0, "warmup_images": 0}
"""Of each generator that trains: three steps."""
SMALL: dict[str, dict[str, Any]] = {
    "vae-gan": {"width": 8, "encoder_width": 4, "discriminator_width": 4},
    "scene-field": {"voxel": 0.008, "coarse_voxel": 0.02},
    "flow": {"width": 16},
}
"""Sizes of the networks that are slow at their own."""


@dataclass(frozen=True)
class Setup:
    """One way to run a stage."""

    threads: int = 1
    batch: int = POSES
    workers: int = 1
    device: str = "cpu"


@dataclass(frozen=True)
class Stage:
    """One stage of the benchmark."""

    name: str
    unit: str
    """Of the largest difference."""
    make: Callable[["Work", Setup], Arrays]
    """What it makes; equal arrays are equal results."""
    compared: tuple[str, ...]
    """The variants, of `run.VARIANTS`, that it is compared in."""


class Work:
    """A folder, and what is made in it once for all stages."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._count = 0
        self._generators: dict[str, Any] = {}

    def new(self) -> Path:
        """Return a path that nothing has been written to."""
        self._count += 1
        return self.folder / f"{self._count}"

    def build(self, workers: int) -> "FrameStore":
        """Build the small dataset anew, and open it."""
        from racines_data.build.dataset import build, make_source, read_data_section
        from racines_data.store.frames import open_store

        config, sections = read_data_section(section(SETTINGS, "data") | {"workers": workers})
        out = self.new()
        build(make_source(config, sections.get(config.source)), out, config)
        return open_store(out)

    @functools.cached_property
    def store(self) -> "FrameStore":
        """The small dataset."""
        return self.build(1)

    @functools.cached_property
    def poses(self) -> Tensor:
        """(64, 12) parameters of its test frames."""
        from racines_models.sample import spread_sample

        return spread_sample(self.store, torch.arange(FRAMES), POSES).frames.parameters

    @functools.cached_property
    def grader(self) -> Any:
        """A grader of one epoch."""
        return self.train_grader("cpu")

    def train_grader(self, device: str) -> Any:
        """Train the small grader anew."""
        from racines_models.judges.grader.model import Grader, GraderConfig
        from racines_models.judges.grader.training import train_grader
        from racines_models.protocol import Run

        config, out = fill(GraderConfig, SETTINGS["grader"], "grader"), self.new()
        train_grader(self.store, config, Run(out, 0, device, progress=False))
        return Grader.load(out, device)

    def generator(self, name: str) -> Any:
        """Return a generator of a few steps, fitted once."""
        if name not in self._generators:
            self._generators[name] = self.fit(name, "cpu")
        return self._generators[name]

    def fit(self, name: str, device: str) -> Any:
        """Fit a generator anew."""
        from dataclasses import fields

        from racines_models.protocol import Run
        from racines_models.registry import generator_class, load_generator

        cls, out = generator_class(name), self.new()
        trains = "training" in {each.name for each in fields(cls.Config)}
        settings = SMALL.get(name, {}) | ({"training": TRAINING} if trains else {})
        config: Any = fill(cls.Config, settings, name)
        cls(config).fit(self.store, Run(out, 0, device, progress=False))
        return load_generator(name, out, device)


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch use some threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_batches(make: Callable[[slice], Tensor], batch: int, count: int = POSES) -> Tensor:
    """Return what `make` gives of `count` rows, asked for `batch` rows at a time."""
    batches = [make(slice(start, start + batch)).cpu() for start in range(0, count, batch)]
    return torch.cat(batches)
