"""A source for tests: small, deterministic, picklable; can stand still and can be wrong."""

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, Unit
from racines_data.views import LABELS, RANDOM_LABEL, VIEWS
from tests.waiting import halt, until


@dataclass(frozen=True)
class FakeConfig:
    frames: int = 200
    seed: int = 0
    trajectories: int = 20
    sessions: int = 2
    views: tuple[str, ...] = VIEWS
    halts_at: int | None = None
    """Number of the unit from which on none is finished."""
    journal: str = ""
    """Folder in which every unit made leaves a mark, with its process and session."""
    processes: int = 1
    """No unit is finished before so many processes have left a mark."""


@dataclass
class FakeSource:
    config: FakeConfig = FakeConfig()
    report: list[Finding] = field(default_factory=list)
    name = "phantom"
    version = "0.1.0"
    Config = FakeConfig

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs=()) -> "FakeSource":
        return cls(FakeConfig(**config))

    def recipe(self) -> dict[str, Any]:
        return {"frames": self.config.frames, "seed": self.config.seed}

    def plan(self) -> list[Unit]:
        c = self.config
        edges = [c.frames * i // c.trajectories for i in range(c.trajectories + 1)]
        return [
            Unit(f"t{i:03d}", f"s{i % c.sessions}", c.views[i % len(c.views)], high - low)
            for i, (low, high) in enumerate(zip(edges, edges[1:], strict=False))
        ]

    def _at_work(self) -> int:
        """Return how many processes have left a mark; one may just be written."""
        marks = (path.read_text().split() for path in Path(self.config.journal).iterdir())
        return len({words[0] for words in marks if words})

    def produce(self, unit: Unit) -> Trajectory:
        if self.config.halts_at is not None and int(unit.id[1:]) >= self.config.halts_at:
            halt()
        if self.config.journal:
            mark = Path(self.config.journal) / f"{unit.id}-{time.monotonic_ns()}"
            mark.write_text(f"{os.getpid()} {unit.session}")
            until(lambda: self._at_work() >= self.config.processes)
        n = unit.frames
        rng = np.random.default_rng([self.config.seed, int(unit.id[1:])])
        parameters = rng.normal(size=(n, 12)).astype(np.float32)
        parameters[:, 6:9] = 0.1 * parameters[:, 6:9] + [0.49, 0.0, 0.1]  # within a robot's reach
        parameters[:, 9:] = 0.2 * parameters[:, 9:] + [2.2, 0.0, 0.0]  # looking down
        parameters[n // 2 :, :6] = np.nan
        views = rng.integers(-1, len(LABELS), n)
        grades = np.where((rng.random(n) < 0.5) | (views < 0), np.nan, 5.0).astype(np.float32)
        grades[views == RANDOM_LABEL] = 0.0
        return Trajectory(
            id=unit.id,
            session=unit.session,
            target_view=unit.target_view,
            images=rng.integers(0, 256, (n, 128, 128), np.uint8),
            parameters=parameters,
            timestamps=np.arange(n) / 30.0,
            controls=np.full((n, 6), np.nan, np.float32),
            views=views,
            grades=grades,
        )
