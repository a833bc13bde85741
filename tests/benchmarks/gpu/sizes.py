"""How large each part is: on a GPU, and so small that a test runs all of them on a CPU."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field

_SEVERAL = {"processes": max(1, len(os.sched_getaffinity(0)) - 3)}


@dataclass(frozen=True)
class Sizes:
    """Sizes of the parts; batch sizes are tried in turn, and the fastest counts."""

    poses: int = 12
    """Canonical poses a scene that are drawn on both devices."""
    scenes: int = 4
    hearts: int = 8
    """Patients that are drawn, still and beating; none are baked where it is 0."""
    rows: int = 256
    """Rows of the episodes that both devices play, and their steps."""
    steps: int = 100
    render: tuple[int, ...] = (64, 2048, 8192)
    images: tuple[int, ...] = (512, 2048, 8192)
    params: tuple[int, ...] = (4096, 32768, 131072, 524288)
    seconds: float = 4.0
    """At least so long each batch size is timed."""
    ppo: tuple[tuple[int, int], ...] = ((1024, 8192), (4096, 32768))
    """Environments, and steps between updates, of the PPO that is timed."""
    updates: int = 12
    ppo_minibatch: int = 4096
    views: tuple[str, ...] = ("SC", "A4C", "PL", "PSAV", "PSMV")
    """Of the paper's own agent."""
    agent: Mapping[str, object] = field(
        default_factory=lambda: {"validate_every": 250_000, "envs": 256}
    )
    """Beside the profile `paper`."""
    profile: str = "paper"
    """Whose dataset and generators are made."""
    generators: tuple[str, ...] = ("vae-gan", "residual-cgan", "attention-cgan", "cgan", "stylegan")
    patients: tuple[str, ...] = ("servo-full", "servo-memory", "ppo-belief")
    """Agents of the grid on patients, entries of the profile `reference`."""
    stores: tuple[str, ...] = ("servo-full", "servo-memory")
    """Those of them that keep what is drawn for them in a folder."""
    goals: int = 5
    """So many views of the grid, the first; each on still and on beating hearts."""
    learning: Mapping[str, Mapping[str, object]] = field(
        default_factory=lambda: dict.fromkeys(("servo-full", "servo-memory"), _SEVERAL)
    )
    """Beside the profile's settings of an agent: what is drawn for it is drawn by many at once."""
    judging: Mapping[str, object] = field(default_factory=dict)
    """Beside those by which they are judged."""


TINY = Sizes(
    poses=2, scenes=1, hearts=0, rows=3, steps=4, render=(2,), images=(2,), params=(2, 4),
    seconds=0.0, ppo=((2, 4),), updates=1, ppo_minibatch=4, views=("SC",), profile="smoke",
    generators=("vae-gan",), patients=("constant-pose",), goals=1,
    learning={"constant-pose": {"patients": 2}},
    judging={"split": "validation", "patients": 1, "starts": 1},
    agent={
        "frames": 8, "envs": 2, "update_every": 4, "minibatch": 4, "epochs": 1,
        "validate_every": 4, "validation_starts": 1, "termination": "first_hit",
    },
)  # fmt: skip
