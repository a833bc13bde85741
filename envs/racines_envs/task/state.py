"""What N environments hold between two steps, and what a step gives."""

from dataclasses import dataclass, fields
from typing import NamedTuple

from torch import Tensor

from racines_data.geometry import Pose


@dataclass
class State:
    """The state of N rows; every field has N rows."""

    position: Tensor
    """(N, 3) m."""
    rotation: Tensor
    """(N, 3, 3)."""
    wrench: Tensor
    """(N, 6) N and N·m, of the probe at rest."""
    seed: Tensor
    """int64 seed of the episode."""
    steps: Tensor
    streak: Tensor
    """Hits in a row."""
    workspace_hits: Tensor
    force_hits: Tensor
    """Steps that would have left the workspace, or pressed over the limit, and became idle."""
    peak_force: Tensor
    """Greatest normal force of the episode, N."""
    force_sum: Tensor
    """Sum of the normal force over the steps, N."""
    total: Tensor
    """Return of the episode, undiscounted."""
    done: Tensor

    @property
    def pose(self) -> Pose:
        """The poses."""
        return Pose(self.position, self.rotation)

    @property
    def force(self) -> Tensor:
        """(N,) normal force, N."""
        return -self.wrench[:, 2]

    def replaced(self, rows: Tensor, other: "State") -> "State":
        """Return the state with the (K,) rows of another of K rows put in."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return State(*(old.index_copy(0, rows, new) for old, new in pairs))


class Transition(NamedTuple):
    """What a step gave; N rows each."""

    observation: dict[str, Tensor]
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
