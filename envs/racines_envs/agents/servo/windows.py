"""The rib spaces beside the one in which a servo believes the view, and which shows it best.

    where it believes the view ---- a rib space towards the feet, one towards the head ---- the best

The heart is seen through spaces between ribs. A neighbouring one shows the valves in the same
places, through a plane that misses the apex, and looks like the view to one who has not seen the
right one (foreshortening: Lang et al., JASE 2015, on finding the apical views). Under the rib
between them a picture tells nothing, so what is read in one space does not lead to the other:
each is looked at for itself, and what was shown there is compared.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise
from racines_envs.agents.servo.belief import UNITS, Belief

SPACE = 0.028
"""From one rib space to the next, m, along the base frame's first axis: the mean of adults'."""
AIM = 0.12
"""Depth of what stays in the middle of the picture meanwhile, m: about where the valves are."""
SPACES = 3
"""The first, the one beside it where the view is likelier, and the one on the other side."""
UNSURE = (0.008, 0.006, 0.001), (0.12, 0.12, 0.2)
"""Standard deviations of what is believed on coming to another space, m and rad."""


@dataclass
class Windows:
    """Of N rows."""

    number: Tensor
    """(N,) int64 of the space in which a row looks, `SPACES` once it has chosen."""
    travels: Tensor
    """(N,) bool: on the way to it, where readings tell of the last."""
    found: list[Belief]
    seen: list[Tensor]
    """Of each space: what was believed there in the end, and (N, 8) what was seen."""
    first: Pose
    """(N,) where the view was believed in the first."""
    side: Tensor
    """(N,) 1 or -1, in which direction the second lies."""

    @classmethod
    def new(cls, belief: Belief, seen: Tensor) -> "Windows":
        """Begin in the first space."""
        none = torch.zeros(len(seen), dtype=torch.int64, device=seen.device)
        empty = [torch.zeros_like(seen) for _ in range(SPACES)]
        right = torch.ones_like(seen[:, 0])
        return cls(none, none.bool(), [belief] * SPACES, empty, belief.pose, right)

    @property
    def chosen(self) -> Tensor:
        """Return (N,) bool: who looks for no other space."""
        return self.number == SPACES

    def forget(self, rows: Tensor) -> None:
        """Begin anew in (N,) bool rows."""
        for each in (self.number, self.travels):
            each.masked_fill_(rows, 0)
        for each in self.seen:
            each.masked_fill_(rows[:, None], 0.0)

    def leave(self, rows: Tensor, belief: Belief, seen: Tensor, centre: Pose, about: Pose) -> None:
        """Note what (N,) bool rows have found in the spaces that they leave.

        Args:
            rows: who leaves.
            belief: what is believed there.
            seen: (N, 8) what was seen there.
            centre: (N,) poses to which both lead.
            about: (N,) poses about which the view lies in people.
        """
        for number in range(SPACES):
            here = rows & (self.number == number)
            self.found[number] = belief.kept(here, self.found[number])
            self.seen[number] = torch.where(here[:, None], seen, self.seen[number])
        begun = rows & (self.number == 0)
        likelier = torch.where(about.position[:, 0] > centre.position[:, 0], 1.0, -1.0)
        self.side = torch.where(begun, likelier, self.side)
        self.first = Pose(
            torch.where(begun[:, None], centre.position, self.first.position),
            torch.where(begun[:, None, None], centre.rotation, self.first.rotation),
        )

    def enter(
        self, rows: Tensor, belief: Belief, seen: Tensor, enough: Tensor
    ) -> tuple[Belief, Tensor]:
        """Send rows on; return what they believe of where they go, and have seen there.

        Args:
            rows: (N,) bool, who has left a space.
            belief: what all rows believe.
            seen: (N, 8) what they have seen.
            enough: (N,) bool, who goes to the best of the spaces seen rather than to another.
        """
        self.number = torch.where(rows, self.number + 1, self.number)
        self.number = torch.where(rows & enough, SPACES, self.number)
        self.travels = self.travels | rows
        side = torch.where(self.number == 1, self.side, -self.side)
        belief = beside(self.first, side).kept(rows & ~self.chosen, belief)
        seen = torch.where(rows[:, None], 0.0, seen)
        best = torch.stack([_worth(each) for each in self.seen]).argmax(0)
        for number in range(SPACES):
            here = rows & self.chosen & (best == number)
            belief = self.found[number].kept(here, belief)
            seen = torch.where(here[:, None], self.seen[number], seen)
        return belief, seen


def _worth(seen: Tensor) -> Tensor:
    """Return (N,) how well the (N, 8) best poses of a space showed the view."""
    shown = seen[:, 7] / seen[:, 0].clamp_min(1e-20)
    return torch.where(seen[:, 0] > 0.0, shown, -1.0)


def beside(pose: Pose, side: Tensor) -> Belief:
    """Return what is believed on coming to a space beside (N,) poses, on (N,) sides."""
    shift = torch.zeros_like(pose.position)
    shift[:, 0] = SPACE * side
    beam = pose.rotation[:, :, 2]
    aimed = normalize(AIM * beam - shift, dim=-1)
    axis = torch.linalg.cross(beam, aimed)
    angle = torch.asin(axis.norm(dim=-1, keepdim=True).clamp_max(1.0))
    turn = axis_angle_to_matrix(normalize(axis, dim=-1) * angle)
    moved = Pose(pose.position + shift, orthonormalise(matmul3(turn, pose.rotation)))
    precise = [
        torch.diag((unit / torch.tensor(each, device=shift.device)).square())
        for each, unit in zip(UNSURE, UNITS, strict=True)
    ]
    return Belief(moved, *(each.expand(len(side), 3, 3) for each in precise))
