"""The floor: every action equally likely."""

from typing import ClassVar

from torch import Tensor

from racines_data.randomness import uniform
from racines_envs.agents.protocol import Untrained
from racines_envs.task.actions import ACTIONS


class RandomAgent(Untrained):
    """Draws uniformly from the thirteen actions."""

    name: ClassVar[str] = "random"
    sees: ClassVar[str] = "nothing"

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Draw (N,) actions from the seeds."""
        return (uniform(seeds, 1)[:, 0] * len(ACTIONS)).long()
