"""A source of data: sweeps of gray images at poses in reach, whose gray is their height."""

from dataclasses import dataclass, field

import numpy as np

from racines_data.config import fill
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, SourceCard, Unit
from racines_data.views import LABELS


@dataclass(frozen=True)
class Config:
    trajectories: int = 18
    seed: int = 0


@dataclass
class Mine:
    config: Config
    report: list[Finding] = field(default_factory=list)
    name = "mine"
    version = "0.3.0"
    Config = Config
    card = SourceCard(
        origin="gray squares of a test",
        license="mit",
        rights="MIT.",
        collection="Painted by a test.",
        limits="Of no use.",
    )

    @classmethod
    def from_config(cls, config, inputs):
        return cls(fill(Config, config, "data.mine"))

    def recipe(self):
        return {**vars(self.config)}

    def plan(self):
        numbers = range(self.config.trajectories)
        return [Unit(f"t{i:02d}", f"s{i % 2}", LABELS[i % 6], 8) for i in numbers]

    def produce(self, unit):
        rng, n = np.random.default_rng([self.config.seed, int(unit.id[1:])]), unit.frames
        position = rng.uniform([0.44, -0.03, 0.06], [0.54, 0.05, 0.07], (n, 3))
        angles = rng.uniform(-0.3, 0.3, (n, 3)) + [np.pi - 0.4, 0.0, 0.0]
        gray = (np.linspace(40, 90, n)[:, None, None] + np.zeros((1, 128, 128))).astype(np.uint8)
        noise = rng.integers(0, 9, (n, 128, 128)).astype(np.uint8)
        parameters = np.concatenate([np.full((n, 6), 0.5), position, angles], -1)
        return Trajectory(
            id=unit.id,
            session=unit.session,
            target_view=unit.target_view,
            images=gray + noise,
            parameters=parameters.astype(np.float32),
            timestamps=np.arange(n) / 30.0,
            controls=np.full((n, 6), np.nan, np.float32),
            views=np.full(n, LABELS.index(unit.target_view)),
            grades=np.linspace(4, 9, n).astype(np.float32) * (unit.target_view != "Random"),
        )
