"""What a servo keeps from step to step of N episodes."""

from dataclasses import dataclass

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_envs.agents.servo.belief import Belief
from racines_envs.agents.servo.search import Search
from racines_envs.task.tiers import middles

MARGIN = 0.02
"""Score by which another pose has to be better."""
WALK = 30
"""Steps that a way to the other side takes at most."""
SIDE = 0.7
"""Share of the distance from the view's middle at which the other side lies."""


@dataclass
class Mind:
    """Of N rows."""

    belief: Belief
    search: Search
    goal: Pose
    """Where a row walks."""
    walk: Tensor
    """(N,) int64 steps left of a walk; 0: none."""
    legs: Tensor
    """(N,) int64 walks so far."""
    steps: Tensor
    """(N,) int64 steps so far."""

    @classmethod
    def new(cls, belief: Belief, count: int, device: torch.device) -> "Mind":
        """Begin episodes with a first belief."""
        none = torch.zeros(count, dtype=torch.int64, device=device)
        search = Search(count, device, MARGIN)
        return cls(belief, search, belief.pose, none, none.clone(), none.clone())

    def forget(self, rows: Tensor) -> None:
        """Begin anew in the (N,) bool rows."""
        self.search.forget(rows)
        for each in (self.walk, self.legs, self.steps):
            each.masked_fill_(rows, 0)

    def depart(self, rows: Tensor, pose: Pose, labels: Tensor) -> None:
        """Let (N,) bool rows walk away: across the view's middle, next time at a right angle."""
        about = middles(labels)
        away = pose.position - about.position
        turned = torch.stack([-away[:, 1], away[:, 0], torch.zeros_like(away[:, 2])], -1)
        across = torch.where((self.legs % 2 == 0)[:, None], -away, turned)
        position = about.position + SIDE * across * across.new_tensor([1.0, 1.0, 0.0])
        self.goal = Pose(
            torch.where(rows[:, None], position, self.goal.position),
            torch.where(rows[:, None, None], about.rotation, self.goal.rotation),
        )
        self.walk = torch.where(rows, WALK, self.walk)
        self.legs = self.legs + rows.long()
        self.search.forget(rows)

    def step(self, arrived: Tensor) -> None:
        """Count a step; (N,) bool rows have come to where they walked."""
        self.steps = self.steps + 1
        self.walk = torch.where(arrived, 0, (self.walk - 1).clamp_min(0))
