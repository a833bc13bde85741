"""What the rows of an environment are in, and what a step gives them."""

from dataclasses import dataclass, fields
from typing import NamedTuple

from torch import Tensor

from racines_data.geometry import Pose


@dataclass
class State:
    """The state of N rows; every field has N rows.

    Position (N, 3), m; rotation (N, 3, 3); wrench (N, 6), N and N·m, of the probe at rest; float64
    joints (N, J) of the arm that carries it, rad, none of a free one; int64 seed of the episode,
    case of the world (which patient) and label of the goal; float64 seconds at which the episode
    began; steps; hits in a row, and whether there ever were enough; idle actions in a row; steps
    that would have left the workspace, pressed over the limit, or that the arm could not follow,
    and became idle; greatest normal force of the episode, N, and its sum over the steps;
    undiscounted return.
    """

    position: Tensor
    rotation: Tensor
    wrench: Tensor
    joints: Tensor
    seed: Tensor
    case: Tensor
    goal: Tensor
    began: Tensor
    steps: Tensor
    streak: Tensor
    reached: Tensor
    idle: Tensor
    workspace_hits: Tensor
    force_hits: Tensor
    arm_hits: Tensor
    peak_force: Tensor
    force_sum: Tensor
    total: Tensor
    done: Tensor

    @property
    def pose(self) -> Pose:
        """The poses."""
        return Pose(self.position, self.rotation)

    @property
    def force(self) -> Tensor:
        """(N,) normal force, N."""
        return -self.wrench[:, 2]

    def taken(self, rows: Tensor | None) -> "State":
        """Return the state of (K,) rows; of all without any."""
        if rows is None:
            return self
        return State(*(getattr(self, each.name)[rows] for each in fields(self)))

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
