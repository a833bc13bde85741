"""Where a servo with a memory goes once its search is over, leg by leg.

    the view, as all images tell it ─ poses about it ─> the best of all passed ─> again ─> rest

On the way to the best pose, and there, it sees more: on a beating heart the same pose at other
moments. So it asks once more which is the best before it rests.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_envs.agents.servo.mind import Mind

ABOUT = (0, 1, 3)
"""Of the servo's waypoints those from which it looks about where the view is believed: the place
itself, a pose beside it, and its opposite."""
CHOICES = 2
"""Times that it chooses among the poses passed."""
LAST = 165
"""Steps after which it looks no further and chooses."""

SHARP = 4
"""Power of a pose's chance by which it counts among the best."""
WIDTH = 0.75
"""In `LIES`, how far about the best pose others count: 15 mm and 9 degrees."""


@dataclass
class Lead:
    """Of N rows."""

    leg: Tensor
    """(N,) int64: 0 while the servo searches, then the number of the leg that a row is on."""
    due: Tensor
    """(N,) bool: who has come to the end of a leg."""
    aim: Pose
    """(N,) where the leg leads."""
    centre: Pose
    """(N,) where the view was believed when the leg began."""

    @classmethod
    def new(cls, pose: Pose) -> "Lead":
        """Begin episodes at (N,) poses."""
        none = torch.zeros(len(pose.position), dtype=torch.int64, device=pose.position.device)
        return cls(none, none.bool(), pose, pose)

    @property
    def leads(self) -> Tensor:
        """Return (N,) bool: whose search is over."""
        return self.leg > 0

    @property
    def looks(self) -> Tensor:
        """Return (N,) bool: who looks about where the view is believed."""
        return self.leads & (self.leg <= len(ABOUT))

    def waypoint(self, further: int) -> Tensor:
        """Return the (N,) waypoint of the leg so much further, the last where there is none."""
        place = (self.leg - 1 + further).clamp(0, len(ABOUT) - 1)
        return torch.tensor(ABOUT, device=place.device)[place]

    def begin(self, mind: Mind, same: Tensor) -> Tensor:
        """Return the (N,) bool rows that begin a leg; those not the same episodes search."""
        self.leg = torch.where(same, self.leg, 0)
        late = self.looks & (mind.steps >= LAST)
        rests = self.leg > len(ABOUT) + CHOICES
        over = torch.where(self.leads, self.due & ~rests, mind.windows.chosen) & same
        self.leg = torch.where(late, len(ABOUT) + 1, self.leg + over.long())
        return over | late


def best_of(where: Tensor, hits: Tensor) -> Tensor:
    """Return (N, 6) the place amid the best of the poses passed, rather than one at their edge.

    A probe comes within half a unit step of a place, and the view ends after one or two.

    Args:
        where: (N, T, 6) where poses lie, in `LIES`.
        hits: (N, T) logits that they show the view, -inf where there is none.
    """
    row = torch.arange(len(hits), device=hits.device)
    best = where[row, hits.argmax(1)]
    away = (where - best.unsqueeze(1)).square().sum(-1)
    weight = hits.sigmoid() ** SHARP * torch.exp(-away / (2.0 * WIDTH**2))
    return (weight.unsqueeze(-1) * where).sum(1) / weight.sum(1, keepdim=True).clamp_min(1e-12)


def either(rows: Tensor, one: Pose, other: Pose) -> Pose:
    """Return one's poses in the (N,) bool rows, the other's in the rest."""
    rotations = torch.where(rows[:, None, None], one.rotation, other.rotation)
    return Pose(torch.where(rows[:, None], one.position, other.position), rotations)
