"""A source for tests whose numbers look like recordings: poses in reach, forces, a clock."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, Unit
from racines_data.views import LABELS


@dataclass(frozen=True)
class ScanConfig:
    frames: int = 240
    seed: int = 0
    trajectories: int = 12
    sessions: int = 2
    forces: bool = True


@dataclass
class ScanSource:
    config: ScanConfig = ScanConfig()
    report: list[Finding] = field(default_factory=list)
    name = "phantom"
    version = "0.1.0"
    Config = ScanConfig

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs=()) -> "ScanSource":
        return cls(ScanConfig(**config))

    def recipe(self) -> dict[str, Any]:
        return {**vars(self.config)}

    def plan(self) -> list[Unit]:
        c = self.config
        edges = [c.frames * i // c.trajectories for i in range(c.trajectories + 1)]
        return [
            Unit(f"t{i:03d}", f"session-{i % c.sessions + 1}", LABELS[i % 6], high - low)
            for i, (low, high) in enumerate(zip(edges, edges[1:], strict=False))
        ]

    def produce(self, unit: Unit) -> Trajectory:
        n = unit.frames
        rng = np.random.default_rng([self.config.seed, int(unit.id[1:])])
        low, high = [0.40, -0.07, 0.04], [0.58, 0.08, 0.13]
        angles = np.stack([rng.uniform(-np.pi, np.pi, n), *rng.uniform(-0.8, 0.8, (2, n))], -1)
        parameters = np.concatenate([rng.normal(0, 6, (n, 6)), rng.uniform(low, high, (n, 3))], -1)
        if not self.config.forces:
            parameters[:, :6] = np.nan
        return Trajectory(
            id=unit.id,
            session=unit.session,
            target_view=unit.target_view,
            images=rng.integers(0, 256, (n, 128, 128), np.uint8),
            parameters=np.concatenate([parameters, angles], -1).astype(np.float32),
            timestamps=1_700_000_000.123456 + np.arange(n) / 30.0,
            controls=rng.normal(0, 0.01, (n, 6)).astype(np.float32),
            views=np.full(n, LABELS.index(unit.target_view)),
            grades=np.full(n, 5.0, np.float32),
        )
