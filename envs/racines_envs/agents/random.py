"""The floor: every action equally likely."""

from typing import ClassVar

from torch import Tensor

from racines_data.randomness import uniform
from racines_envs.agents.protocol import Untrained
from racines_envs.task.actions import ACTIONS
from racines_envs.task.names import TIERS


class RandomAgent(Untrained):
    """Draws uniformly from the thirteen actions."""

    name: ClassVar[str] = "random"
    sees: ClassVar[str] = "nothing"
    tiers: ClassVar[tuple[str, ...]] = TIERS

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Draw (N,) actions from the seeds; where a mask is seen, of those that it lets through."""
        drawn = uniform(seeds, 1)[:, 0]
        if "action_mask" not in observation:
            return (drawn * len(ACTIONS)).long()
        allowed = observation["action_mask"]
        place = (drawn.to(allowed.device) * allowed.sum(1)).long()
        return (allowed.cumsum(1) > place[:, None]).int().argmax(1)
