"""The one loop that lets an agent act: every start of a set at once, one episode each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from racines_envs.agents.protocol import Agent
from racines_envs.task.core import ScanCore


@dataclass(frozen=True)
class Episodes:
    """What n episodes came to."""

    final: dict[str, np.ndarray]
    """`ScanCore.info` when each ended, (n,) each."""
    positions: np.ndarray
    """(T + 1, n, 3) m; after its end an episode stays where it was."""
    probabilities: np.ndarray
    """(T + 1, n) p by the reward's own source."""
    parameters: Tensor
    """(n, 12) at the end."""
    seeds: Tensor
    """(n,) episode seeds."""
    actions: tuple[Tensor, ...] = ()
    """(n,) int64 of each step; those behind an episode's end did nothing."""


def join_episodes(parts: Sequence[Episodes]) -> Episodes:
    """Return episodes that were run apart as those of one call, but for their actions."""
    longest = max(len(each.positions) for each in parts)

    def lengthen(values: np.ndarray) -> np.ndarray:
        """After its end an episode stays as it was."""
        return np.concatenate([values, np.repeat(values[-1:], longest - len(values), 0)])

    return Episodes(
        final={k: np.concatenate([each.final[k] for each in parts]) for k in parts[0].final},
        positions=np.concatenate([lengthen(each.positions) for each in parts], 1),
        probabilities=np.concatenate([lengthen(each.probabilities) for each in parts], 1),
        parameters=torch.cat([each.parameters for each in parts]),
        seeds=torch.cat([each.seeds for each in parts]),
    )


@torch.no_grad()
def rollout(core: ScanCore, agent: Agent, seeds: Tensor, case: Tensor | None = None) -> Episodes:
    """Run the episodes of (n,) seeds until all have ended; n is the core's number of rows.

    They may be of given (n,) cases of the world, not of those that the seeds name.

    What has ended is looked at no more, so that episodes cost what their own steps cost. The agent
    still sees all rows, and may keep a memory of each; one that has none (`remembers` is False) is
    asked of the live rows alone.
    """
    agent.attach(core)
    observation = core.reset(seeds, case=case)
    positions, probabilities, actions = [core.state.position], [core.score.probability], []
    for _ in range(core.task.max_steps):
        live = (~core.state.done).nonzero().squeeze(1)
        if len(live) == 0:
            break
        rows = live if len(live) < core.num_envs else None
        action = _act(agent, observation, core.decision_seeds(), rows, actions)
        observation = core.step(action, rows=rows).observation
        positions.append(core.state.position)
        probabilities.append(core.score.probability)
        actions.append(action)
    return Episodes(
        final={name: value.cpu().numpy() for name, value in core.info().items()},
        positions=torch.stack(positions).cpu().numpy(),
        probabilities=torch.stack(probabilities).cpu().numpy(),
        parameters=core.parameters,
        seeds=core.state.seed,
        actions=tuple(actions),
    )


def _act(
    agent: Agent, observation: dict[str, Tensor], seeds: Tensor, rows: Tensor | None,
    before: list[Tensor],
) -> Tensor:  # fmt: skip
    """Return the (n,) actions of all rows; what has ended may repeat its last one."""
    if rows is None or getattr(agent, "remembers", True):
        return agent.act(observation, seeds)
    chosen = agent.act({name: value[rows] for name, value in observation.items()}, seeds[rows])
    return before[-1].index_copy(0, rows.to(chosen.device), chosen)
