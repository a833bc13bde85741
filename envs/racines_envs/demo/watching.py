"""An episode of the servo, watched: what it sees, what it believes, and what is true."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.belief import UNITS
from racines_envs.task.core import ScanCore


class Watched(ServoAgent):
    """The servo, and what it believes."""

    name: ClassVar[str] = "servo"
    centre: Pose
    """(N,) where it believes the view to be."""
    grade: Tensor
    """(N,) how good it reads the present picture to be, 0-10."""
    spread: Tensor
    """(N,) one standard deviation of where it believes the view, along all axes together, m."""

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Act as the servo does, and keep what it believes."""
        action, labels = super().act(observation, seeds), self._labels(observation)
        assert self._mind is not None
        self.centre = self._mind.centre(labels)
        known = self._mind.belief.among(labels).placed.double()
        variance = torch.linalg.inv(known).diagonal(dim1=1, dim2=2).sum(1)
        self.spread = UNITS[0] * variance.clamp_min(0.0).sqrt()
        read = self.readings(observation["image"])
        self.grade = read.grades[torch.arange(len(labels)), labels]
        return action


class Shot(NamedTuple):
    """What one row shows at a step."""

    image: np.ndarray
    """(128, 128) uint8."""
    step: int
    grade: float
    distance: float
    """Millimetres to the patient's own pose."""
    believed: float
    """Millimetres to where the servo believes it."""
    read: float
    """Grade that the servo reads from the picture."""
    ended: bool
    spread: float = 0.0
    """Millimetres by which the servo holds its belief of the place to be uncertain."""
    view: int = 0
    """The label of the true view."""
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Of the probe, m, base frame."""
    rotation: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    """Of the probe, row by row."""
    aim: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Where the servo believes the view, m."""


@torch.no_grad()
def watch(
    core: ScanCore, agent: Watched, seeds: Tensor, case: Tensor,
    seen: Callable[[list[list[Shot]]], None] | None = None,
) -> list[list[Shot]]:  # fmt: skip
    """Let a servo act from the (N,) seeds on the (N,) cases; return what each row shows.

    `seen` is told all shots so far after every step.
    """
    agent.attach(core)
    shots: list[list[Shot]] = [[] for _ in seeds]
    observation = core.reset(seeds, case=case)
    for _ in range(core.task.max_steps):
        live = ~core.state.done
        if not bool(live.any()):
            break
        action = agent.act(observation, core.decision_seeds())
        look(core, agent, shots, live)
        if seen:
            seen(shots)
        rows = live.nonzero().squeeze(1)
        observation = core.step(action, rows=rows if len(rows) < len(seeds) else None).observation
    agent.act(observation, core.decision_seeds())
    look(core, agent, shots, torch.ones(len(seeds), dtype=torch.bool))
    if seen:
        seen(shots)
    return shots


def look(core: ScanCore, agent: Watched, shots: list[list[Shot]], live: Tensor) -> None:
    """Keep what the (N,) live rows show; a row that has ended once more, as its last picture."""
    info, images = core.info(view_error=False), core.picture()
    believed = (agent.centre.position - core.state.position).norm(dim=1)
    for row, own in enumerate(shots):
        ended = bool(core.state.done[row])
        if not live[row] or (own and own[-1].ended):
            continue
        own.append(
            Shot(
                images[row].cpu().numpy(),
                int(core.state.steps[row]),
                float(info["grade"][row]),
                float(1e3 * info["position_error"][row]),
                float(1e3 * believed[row]),
                float(agent.grade[row]),
                ended,
                spread=1e3 * float(agent.spread[row]),
                view=int(info["view"][row]),
                position=_numbers(core.state.position[row]),
                rotation=_numbers(core.state.rotation[row]),
                aim=_numbers(agent.centre.position[row]),
            )
        )


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(values.flatten().tolist())
