"""The embedded sources: sweeps over simulated blocks, images and truth from the phantom.

`PhantomSource` scans the one canonical phantom, for the config `frames`; `MultiPhantomSource` scans
many hearts, with one short sweep a view and one random scan of each, for `multi_phantom`.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM
from racines_data.phantom.acquisition import (
    AcquisitionConfig,
    make_sweep,
    plan_lengths,
    plan_targets,
    record,
)
from racines_data.phantom.anatomy import anatomy_views
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig, heart_config
from racines_data.phantom.model import shared_phantom
from racines_data.phantom.pacing import FREE, joint_count
from racines_data.phantom.saved import provenance
from racines_data.randomness import derive, sample_seeds
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, SourceCard, Unit, card_with
from racines_data.views import labels_of

_STREAM = 0x4EA7
"""Keeps the sweeps of many hearts apart from those of the canonical one under the same seed."""

CARD = SourceCard(
    origin="simulated ultrasound of the RACINES phantom; no frame comes from a scanner",
    license="cc-by-4.0",
    rights="CC BY 4.0.",
    tags=("simulation", "synthetic"),
    simulated=True,
    like_paper=True,
    collection="Simulated: a seeded acquisition by a simulated robot arm that moves a phased-array "
    "probe over a simulated cardiac block in joystick-like sweeps (approach, overshoot, "
    "correction, dwell, leave) and random scans. Images, forces and torques come from models of "
    "acoustics and contact. No frame comes from a scanner, and no person took part.",
    collection_type="Software Collection",
    annotation="View and grade (0-10) are computed from the true pose and the anatomy: which of "
    "the view's structures lie in the plane and the sector, and how clearly. This oracle stands in "
    "for an expert and is not one.",
    biases="One simulated block at nominal size is the `frames` config: anatomy, pathology, body "
    "habitus and breathing do not vary. `multi_phantom`, where present, varies size, wall and "
    "orientation within adult ranges, not disease. One probe and one robot. Sweeps imitate one "
    "style of operator.",
    limitations="Simulated images differ from real echo; docs/phantom.md gives the measured "
    "distance. Neighbouring frames of a sweep are near-copies: split by trajectory only. Never to "
    "be mixed with, or presented as, recordings of the real block.",
    personal="None: simulated; there is no subject.",
    limits="The images are simulated. They are never to be mixed with, or presented as, recordings "
    "of the real block. Neighbouring frames are near-copies: keep trajectories whole. Views and "
    "grades come from geometry (an oracle), not from an expert.",
)


@dataclass(frozen=True)
class SweepUnit(Unit):
    """A planned sweep."""

    index: int = 0
    """Number of the sweep, of a heart where there are several."""
    heart: int = 0
    """Seed of the anatomy, where there are several hearts."""


class PhantomSource:
    """Acquires trajectories from the phantom; every one depends on its index and the seed alone."""

    name = "phantom"
    version = "1.0.0"
    Config = AcquisitionConfig
    card = CARD

    def __init__(self, config: AcquisitionConfig):
        self.config = config
        self.report: list[Finding] = []
        self.labels = labels_of(anatomy_views(config.phantom.anatomy))
        if own := provenance(config.phantom.anatomy):
            self.card = card_with(CARD, own)

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> Self:
        """Make the source; it reads no input files.

        Raises:
            RacinesError: unknown settings, impossible numbers, or input files given.
        """
        if inputs:
            raise RacinesError("the phantom reads no --input: drop it, or name another --source")
        settings = fill(AcquisitionConfig, config, "data.phantom")
        if settings.frames < 2 or settings.shortest < 2 or settings.longest < settings.shortest:
            raise RacinesError(
                "data.phantom: frames and shortest must be at least 2 and longest no less than "
                f"shortest; got {settings.frames}, {settings.shortest}, {settings.longest}"
            )
        if settings.robot != FREE:  # an unknown one is told before the first sweep
            joint_count(settings.robot)
        return cls(settings)

    def recipe(self) -> dict[str, Any]:
        """Return what decides the bytes: the phantom's version and all settings."""
        told = {"phantom": PHANTOM_VERSION, "acquisition": self.config.told()}
        own = provenance(self.config.phantom.anatomy)
        return told | ({"own": own} if own else {})

    def plan(self) -> Sequence[SweepUnit]:
        """Return the sweeps in order, sessions in turn."""
        units, sessions, lengths = [], self.config.sessions, plan_lengths(self.config)
        targets = plan_targets(len(lengths), self.config)
        for i, (length, target) in enumerate(zip(lengths, targets, strict=True)):
            session = f"session-{min(i * sessions // len(lengths), sessions - 1) + 1}"
            units.append(SweepUnit(f"{i:05d}-{target.lower()}", session, target, length, i))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Acquire one sweep."""
        assert isinstance(unit, SweepUnit)
        seed = derive(sample_seeds(self.config.seed, 1), unit.index, 1)
        session = int(unit.session.rpartition("-")[2]) - 1
        return _acquire(self.config.phantom, self.config, unit, session, seed)


@dataclass(frozen=True)
class MultiPhantomConfig:
    """How many hearts are scanned, and for how long each."""

    hearts: int = 0
    """Number of hearts: the anatomy's seeds 1, 2, … 0 leaves the config out."""
    frames_per_sweep: int = 40
    """Frames of each sweep."""
    seed: int = 0
    """Draws the sweeps."""


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
            "acquisition": self.acquisition.told(),
        }

    def plan(self) -> Sequence[SweepUnit]:
        """Return the sweeps in order, heart by heart."""
        frames, units = self.config.frames_per_sweep, []
        for heart in range(1, self.config.hearts + 1):
            for index, target in enumerate(self.labels):
                name, session = f"h{heart:04d}-{target.lower()}", f"heart-{heart:04d}"
                units.append(SweepUnit(name, session, target, frames, index, heart))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Acquire one sweep; hearts take turns among the operators."""
        assert isinstance(unit, SweepUnit)
        phantom = heart_config(self.acquisition.phantom, unit.heart)
        seed = derive(sample_seeds(self.config.seed, 1), _STREAM, unit.heart, unit.index)
        operator = unit.heart % self.acquisition.sessions
        return _acquire(phantom, self.acquisition, unit, operator, seed)


def _acquire(
    scanned: PhantomConfig, config: AcquisitionConfig, unit: Unit, session: int, seed: Tensor
) -> Trajectory:
    """Acquire the sweep of a unit by the operator of a session; `seed` decides path and noise."""
    phantom = shared_phantom(scanned)
    sweep = make_sweep(phantom, config, unit.target_view, session, unit.frames, seed)
    truth = phantom.judge(sweep.pose)
    return Trajectory(
        id=unit.id,
        session=unit.session,
        target_view=unit.target_view,
        images=phantom.render(sweep.pose, sample_seeds(int(derive(seed, 3)), unit.frames)).numpy(),
        parameters=record(phantom, config, sweep, seed).numpy(),
        timestamps=sweep.times.numpy(),
        controls=sweep.control.numpy(),
        views=truth.view.numpy(),
        grades=truth.grade.numpy().astype(np.float32),
        phantom=phantom.config.anatomy_seed,
    )
