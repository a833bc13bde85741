"""What a reward pays for an episode, worked out from one look at where the agent went.

Until it ends, an episode does not depend on the rule that ends it. So one run to the last step,
ended by nothing, holds the episodes of all termination rules, and of all rewards of one source.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from racines_envs.agents.protocol import Agent
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import RewardConfig, Score, get_reward, is_hit


@dataclass(frozen=True)
class ScoredSteps:
    """T steps of n rows."""

    score: Score
    """(T + 1, n) each: p, g and distance by the reward's source; the first is the start's."""
    sees: Tensor
    """(T + 1, n) bool, the true view is the target's."""
    grade: Tensor
    """(T + 1, n) true grade as the target view, 0 where that is not seen."""


@dataclass(frozen=True)
class Settled:
    """What n episodes came to under one reward and one rule; (n,) each."""

    total: np.ndarray
    """The return."""
    steps: np.ndarray
    success: np.ndarray
    """The true view at the end is the target's."""
    graded: np.ndarray
    """And its true grade is that of a hit."""
    grade: np.ndarray
    """True grade as the target view at the end, 0 where that is not seen."""
    hits: np.ndarray
    """Steps that were hits, by the reward's source."""
    seen: np.ndarray
    """Steps that showed the view confidently and were no hits, by the reward's source."""
    probability: np.ndarray
    """p at the end less p at the start."""

    @property
    def hovered(self) -> np.ndarray:
        """Steps spent in the view, hits or not."""
        return self.hits + self.seen


@torch.no_grad()
def run_scored(core: ScanCore, agent: Agent, seeds: Tensor) -> ScoredSteps:
    """Run the episodes of (n,) seeds for all steps of a task that ends by `timeout`."""
    agent.attach(core)
    observation = core.reset(seeds)
    looks = [_look(core)]
    for _ in range(core.task.max_steps):
        observation = core.step(agent.act(observation, core.decision_seeds())).observation
        looks.append(_look(core))
    *score, sees, grade = (torch.stack(values) for values in zip(*looks, strict=True))
    return ScoredSteps(Score(*score), sees, grade)


def _look(core: ScanCore) -> tuple[Tensor, ...]:
    sees = core.sees_target()
    return (*core.score, sees, core.scored_by("oracle").grade * sees)


def settle(trace: ScoredSteps, reward: str, hits_to_end: int, rewards: RewardConfig) -> Settled:
    """Return what the episodes come to where `hits_to_end` hits in a row end them; 0: none do.

    The same as the environment's own account under that reward and rule, as a test holds.
    """
    before, after = (Score(*(x[part] for x in trace.score)) for part in (slice(-1), slice(1, None)))
    hit = is_hit(after, rewards)
    last, ended = _ends(hit, hits_to_end)
    step = torch.arange(len(hit), device=hit.device).unsqueeze(1)
    live, terminated = step <= last, (step == last) & ended
    paid = get_reward(reward)(before, after, terminated, rewards) * live
    confident = after.probability >= rewards.probability

    def at_end(values: Tensor) -> Tensor:
        return values.gather(0, (last + 1).unsqueeze(0)).squeeze(0)

    success, grade = at_end(trace.sees), at_end(trace.grade)
    values = {
        "total": paid.sum(0),
        "steps": last + 1,
        "success": success,
        "graded": success & (grade >= rewards.grade),
        "grade": grade,
        "hits": (hit & live).sum(0),
        "seen": (confident & ~hit & live).sum(0),
        "probability": at_end(trace.score.probability) - trace.score.probability[0],
    }
    return Settled(**{name: value.cpu().numpy() for name, value in values.items()})


def _ends(hit: Tensor, needed: int) -> tuple[Tensor, Tensor]:
    """Return the (n,) last step of (T, n) hits, from 0, and whether hits ended it."""
    streak = torch.zeros_like(hit[0], dtype=torch.int64)
    last = torch.full_like(streak, len(hit) - 1)
    ended = torch.zeros_like(hit[0])
    if needed:
        for t, now in enumerate(hit):
            streak = (streak + 1) * now
            through = (streak >= needed) & ~ended
            last = torch.where(through, t, last)
            ended = ended | through
    return last, ended
