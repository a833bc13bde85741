"""Where a servo with a memory goes once its search is over, leg by leg.

    the view, as all images tell it ─ poses about it ─> the best of all passed ─> again ─> rest

On the way to the best pose, and there, it sees more: on a beating heart the same pose at other
moments. So it asks once more which is the best before it rests. It may look about the best pose as
well, before it asks (`looks`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_envs.agents.servo.mind import Mind

ABOUT = (0, 1, 3)
"""Of the servo's waypoints those from which it looks about where the view is believed: the place
itself, a pose beside it, and its opposite."""
BESIDE = (1, 2, 3, 4)
"""Those from which it may look about the best pose passed."""
CHOICES = 2
"""Times that it chooses among the poses passed, and goes to the one chosen."""
LAST, LATEST = 165, 178
"""Steps after which it looks no further about where the view is believed, and about the best."""

BELIEVED, BEST, CHOICE = range(3)
"""What a leg leads to: a pose about where the view is believed, or about the best poses passed; or
amid these."""

SHARP = 4
"""Power of a pose's chance by which it counts among the best."""
WIDTH = 0.75
"""In `LIES`, how far about the best pose others count: 15 mm and 9 degrees."""


class Legs(NamedTuple):
    """What the L legs lead to, one after the other."""

    kinds: Tensor
    """(L,) int64, `BELIEVED`, …"""
    waypoints: Tensor
    """(L,) int64 of the servo's waypoints; 0 where none is meant."""
    choices: Tensor
    """(L,) int64, the number of the next leg that is a choice."""

    @classmethod
    def planned(cls, looks: int, device: torch.device) -> "Legs":
        """Return the legs with so many looks about the best, before it chooses again."""
        about = [(BELIEVED, each) for each in ABOUT]
        beside = [(BEST, each) for each in BESIDE[:looks]]
        begun = [(CHOICE, 0)] if beside else []
        legs = [*about, *begun, *beside, *[(CHOICE, 0)] * (CHOICES + 1)]
        chooses = [number for number, (kind, _) in enumerate(legs, 1) if kind == CHOICE]
        after = [
            min((each for each in chooses if each > number), default=len(legs))
            for number in range(1, len(legs) + 1)
        ]
        kinds, waypoints = zip(*legs, strict=True)
        return cls(*(torch.tensor(each, device=device) for each in (kinds, waypoints, after)))


@dataclass
class Lead:
    """Of N rows."""

    legs: Legs
    leg: Tensor
    """(N,) int64: 0 while the servo searches, then the number of the leg that a row is on."""
    due: Tensor
    """(N,) bool: who has come to the end of a leg."""
    aim: Pose
    """(N,) where the leg leads."""
    centre: Pose
    """(N,) about where a row looks, if it does."""

    @classmethod
    def new(cls, pose: Pose, legs: Legs) -> "Lead":
        """Begin episodes at (N,) poses."""
        none = torch.zeros(len(pose.position), dtype=torch.int64, device=pose.position.device)
        return cls(legs, none, none.bool(), pose, pose)

    @property
    def leads(self) -> Tensor:
        """Return (N,) bool: whose search is over."""
        return self.leg > 0

    @property
    def kind(self) -> Tensor:
        """Return the (N,) kinds of the legs that rows are on, -1 while they search."""
        return torch.where(self.leads, self.legs.kinds[self._place(0)], -1)

    @property
    def looks(self) -> Tensor:
        """Return (N,) bool: who looks about a place."""
        return (self.kind == BELIEVED) | (self.kind == BEST)

    @property
    def looks_on(self) -> Tensor:
        """Return (N,) bool: who looks about a place, and will after this leg."""
        return self.looks & (self.legs.kinds[self._place(1)] == self.kind)

    def waypoint(self, further: int) -> Tensor:
        """Return the (N,) waypoint of the leg so much further, the last where there is none."""
        return self.legs.waypoints[self._place(further)]

    def _place(self, further: int) -> Tensor:
        return (self.leg - 1 + further).clamp(0, len(self.legs.kinds) - 1)

    def begin(self, mind: Mind, same: Tensor) -> Tensor:
        """Return the (N,) bool rows that begin a leg; those not the same episodes search."""
        self.leg = torch.where(same, self.leg, 0)
        late = (self.kind == BELIEVED) & (mind.steps >= LAST)
        late = late | (self.kind == BEST) & (mind.steps >= LATEST)
        rests = self.leg >= len(self.legs.kinds)
        over = torch.where(self.leads, self.due & ~rests, mind.windows.chosen) & same
        following = self.leg + over.long()
        self.leg = torch.where(late, self.legs.choices[self._place(0)], following)
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
