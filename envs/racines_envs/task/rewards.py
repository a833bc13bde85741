"""Rewards, as data: a formula on scores that a grader or the oracle gave, and what it needs.

A new reward is one `Reward` in one file, and one entry point of the group `racines.rewards`.

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

from racines_data.plugins import Plugins


class Score(NamedTuple):
    """How good N poses are, by a grader or by the oracle."""

    probability: Tensor
    """(N,) p, that the image shows the target view."""
    grade: Tensor
    """(N,) g, 0-10, as the target view."""
    distance: Tensor
    """(N,) unit steps from the nominal pose, by the oracle; zeros where no reward needs it."""


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


@dataclass(frozen=True)
class Reward:
    """A reward: what a step pays, and what has to be known to say so."""

    name: str
    formula: str
    """What a step pays, for people: of p, g and d before and (with a prime) after the step."""
    pay: Callable[[Score, Score, Tensor, RewardConfig], Tensor]
    """(before, after, ended (N,) bool, config) -> (N,) float32; a row by itself alone."""
    needs_judge: bool = False
    """p and g are a trained grader's, which looks at the image of every step; else the oracle's."""
    needs_distance: bool = False
    """`Score.distance` is worked out."""
    rest: str = "beside_the_step_cost"
    """What the report calls that which is paid beside `step`."""

    @property
    def judged_by(self) -> str:
        """Whose p and g it goes by: `grader` or `oracle`."""
        return "grader" if self.needs_judge else "oracle"

    def __call__(self, before: Score, after: Score, ended: Tensor, config: RewardConfig) -> Tensor:
        """Return what a step pays each row, (N,) float32."""
        return self.pay(before, after, ended, config)


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


_PAPER = "50 (g' >= 5) or 20 where p' >= 0.9; + p' - p; + g' - g where p' >= 0.9; - 0.1"
_SHAPED = "50 where hits end the episode; + d - 0.99 d' (d' = 0 at the end); - 0.1"
PAPER = Reward("paper", _PAPER, paper, needs_judge=True)
ORACLE = Reward("oracle", _PAPER, paper)
SHAPED = Reward("shaped", _SHAPED, shaped, needs_distance=True, rest="prize_and_potential")
_NEEDED = ("name", "formula", "pay", "needs_judge", "needs_distance")
REWARDS = Plugins("reward", "racines.rewards", _NEEDED, "module:REWARD")


def get_reward(reward: str | Reward) -> Reward:
    """Return a reward by a known name, by `module:REWARD`, or as it is given."""
    return REWARDS.load(reward) if isinstance(reward, str) else reward


def follows_paper(reward: str) -> bool:
    """Return whether a reward is known and pays by the paper's formula, whoever scores it."""
    return reward in REWARDS.names() and get_reward(reward).pay is paper
