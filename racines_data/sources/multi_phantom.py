"""Many simulated hearts: one short sweep per view and one random scan of each.

They make the config `multi_phantom`, beside the `frames` of the one canonical phantom.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM
from racines_data.phantom.acquisition import AcquisitionConfig
from racines_data.phantom.anatomy import anatomy_views
from racines_data.phantom.config import PHANTOM_VERSION, heart_config
from racines_data.phantom.model import shared_phantom
from racines_data.randomness import derive, sample_seeds
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, Unit
from racines_data.sources.phantom import PhantomSource, acquire
from racines_data.views import labels_of

_STREAM = 0x4EA7
"""Keeps the sweeps apart from those of the canonical phantom under the same seed."""


@dataclass(frozen=True)
class MultiPhantomConfig:
    """How many hearts are scanned, and for how long each."""

    hearts: int = 0
    """Number of hearts: the anatomy's seeds 1, 2, … 0 leaves the config out."""
    frames_per_sweep: int = 40
    """Frames of each sweep."""
    seed: int = 0
    """Draws the sweeps."""


@dataclass(frozen=True)
class HeartUnit(Unit):
    """A planned sweep over one heart."""

    heart: int = 1
    """Seed of the anatomy."""
    index: int = 0
    """Number of the sweep within its heart."""


class MultiPhantomSource:
    """Acquires sweeps of many hearts; a heart is a session."""

    name = PhantomSource.name
    version = PhantomSource.version
    Config: ClassVar[type] = MultiPhantomConfig

    def __init__(self, config: MultiPhantomConfig, acquisition: AcquisitionConfig):
        self.config = config
        self.acquisition = acquisition
        self.report: list[Finding] = []
        self.labels = labels_of(anatomy_views(acquisition.phantom.anatomy))

    @classmethod
    def from_config(
        cls,
        config: dict[str, Any],
        inputs: Sequence[Path] = (),
        acquisition: AcquisitionConfig | None = None,
    ) -> Self:
        """Make the source; operator, sensors and the base of the phantom are `acquisition`'s.

        Raises:
            RacinesError: unknown settings or impossible numbers.
        """
        settings = fill(MultiPhantomConfig, config, f"data.{MULTI_PHANTOM}")
        if settings.hearts < 0 or settings.frames_per_sweep < 2:
            raise RacinesError(
                f"data.{MULTI_PHANTOM}: hearts must be 0 or more and frames_per_sweep 2 or more; "
                f"got {settings.hearts} and {settings.frames_per_sweep}"
            )
        return cls(settings, acquisition or AcquisitionConfig())

    def recipe(self) -> dict[str, Any]:
        """Return what decides the bytes: the phantom's version and all settings."""
        return {
            "phantom": PHANTOM_VERSION,
            MULTI_PHANTOM: dataclasses.asdict(self.config),
            "acquisition": dataclasses.asdict(self.acquisition),
        }

    def plan(self) -> Sequence[HeartUnit]:
        """Return the sweeps in order, heart by heart."""
        return [
            HeartUnit(
                id=f"h{heart:04d}-{target.lower()}",
                session=f"heart-{heart:04d}",
                target_view=target,
                frames=self.config.frames_per_sweep,
                heart=heart,
                index=index,
            )
            for heart in range(1, self.config.hearts + 1)
            for index, target in enumerate(self.labels)
        ]

    def produce(self, unit: Unit) -> Trajectory:
        """Acquire one sweep; hearts take turns among the operators."""
        assert isinstance(unit, HeartUnit)
        phantom = shared_phantom(heart_config(self.acquisition.phantom, unit.heart))
        seed = derive(sample_seeds(self.config.seed, 1), _STREAM, unit.heart, unit.index)
        operator = unit.heart % self.acquisition.sessions
        return acquire(phantom, self.acquisition, unit, operator, seed)
