"""Rewards: functions of one signature, on scores that a grader or the oracle gave.

`paper` and `oracle` are one formula (equations 2-5 of the paper) on two sources of p and g. It pays
for lingering (20 a step for the right view drawn badly), so `shaped` stands beside it: a sparse
prize plus the change of a potential, which no cycle of moves can farm (Ng et al., Policy Invariance
under Reward Transformations, 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.errors import RacinesError


class Score(NamedTuple):
    """How good N poses are, by a grader or by the oracle."""

    probability: Tensor
    """(N,) p, that the image shows the target view."""
    grade: Tensor
    """(N,) g, 0-10, as the target view."""
    distance: Tensor
    """(N,) unit steps from the nominal pose, by the oracle; only `shaped` looks at it."""


@dataclass(frozen=True)
class RewardConfig:
    """The numbers of the reward; the defaults are the paper's."""

    probability: float = 0.9
    """Least p of a hit."""
    grade: float = 5.0
    """Least g of a hit."""
    hit: float = 50.0
    """Paid for a hit."""
    view: float = 20.0
    """Paid for the right view below that grade (`paper` and `oracle`)."""
    step: float = -0.1
    """Paid every step. The paper says "a small negative constant" and no more."""
    distance: float = 1.0
    """Paid a unit step nearer to the nominal pose (`shaped`)."""
    discount: float = 0.99
    """The discount that `shaped` is built for."""


Reward = Callable[[Score, Score, Tensor, RewardConfig], Tensor]
"""(before, after, ended (N,) bool, config) -> (N,) float32."""


def is_hit(score: Score, config: RewardConfig) -> Tensor:
    """Return (N,) bool: the target view, confidently and in good quality."""
    return (score.probability >= config.probability) & (score.grade >= config.grade)


def paper(before: Score, after: Score, ended: Tensor, config: RewardConfig) -> Tensor:
    """Return base + class + grade + step, equations 2-5 of the paper."""
    seen = after.probability >= config.probability
    base = torch.where(seen, torch.where(after.grade >= config.grade, config.hit, config.view), 0.0)
    change = torch.where(seen, after.grade - before.grade, 0.0)
    return base + (after.probability - before.probability) + change + config.step


def shaped(before: Score, after: Score, ended: Tensor, config: RewardConfig) -> Tensor:
    """Return the prize of an episode that ended by hits, the step cost, and a potential's change.

    The potential is minus the distance to the nominal pose; it is 0 where an episode has ended.
    """
    ahead = torch.where(ended, 0.0, after.distance)
    change = config.distance * (before.distance - config.discount * ahead)
    return torch.where(ended, config.hit, 0.0) + config.step + change


REWARDS: dict[str, Reward] = {"paper": paper, "oracle": paper, "shaped": shaped}
"""By name; `paper` is scored by the grader, the others by the oracle."""


def get_reward(name: str) -> Reward:
    """Return a reward by name.

    Raises:
        RacinesError: no such reward.
    """
    if name not in REWARDS:
        raise RacinesError(f"unknown reward {name!r}: choose one of {', '.join(REWARDS)}")
    return REWARDS[name]
