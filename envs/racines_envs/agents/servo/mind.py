"""What a servo keeps from step to step of N episodes, and where it wants to be.

    belief ---- waypoint 1 about it, waypoint 2, … ---- the next window, … ---- the best, to rest

Readings of neighbouring images err alike; those of poses about a view err in their own ways, and
their mean is more exact. So a servo that has come to where it believes the view does not rest yet:
it looks on from poses about it, and goes to what all of them say. They say it twice: by where they
read the view, and by how completely they show it themselves, of which the weighted mean of the
poses is taken, as in the cross-entropy method (Rubinstein and Kroese, 2004).

One rib space off, a picture looks much like the view and is foreshortened; between the spaces
there is shadow, so that nothing leads from one to the other. The servo therefore goes there too,
and rests where the view was shown best: see `windows`.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    rotate,
    rotation_vector,
)
from racines_envs.agents.servo.belief import FADE, LASTING, Belief
from racines_envs.agents.servo.windows import Windows
from racines_envs.task.tasks import Task
from racines_envs.task.tiers import middles

WAYPOINTS = 4
"""Poses about the belief from which it looks in each space; ways are walked step by step, looking
all along."""
REACH = (1.5, 1.5, 0.0, 1.5, 1.5, 1.5)
"""Unit steps to either side, along and about the probe's axes; its pressure stays."""
CHOOSE = 150
"""Steps after which it goes to the best of the spaces that it has seen, to rest there."""
FURTHER = 95
"""Steps after which the space on the other side is not worth the way."""
GOLDEN = 1.1347241384
"""Positive root of x⁶ = x + 1, whose inverse powers spread points evenly in five dimensions
(Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018)."""


def waypoints() -> Tensor:
    """Return (W + 1, 6) offsets in unit steps, the first 0: the belief itself.

    The second half are the first half's opposites, so that their mean is the belief.
    """
    count = torch.arange(1, WAYPOINTS // 2 + 1, dtype=torch.float64).unsqueeze(1)
    powers = GOLDEN ** -torch.tensor([1.0, 2.0, 0.0, 3.0, 4.0, 5.0], dtype=torch.float64)
    spread = 2.0 * (0.5 + count * powers).frac() - 1.0
    offsets = torch.cat([spread, -spread]) * torch.tensor(REACH, dtype=torch.float64)
    return torch.cat([offsets.new_zeros(1, 6), offsets]).float()


SHARP = 8.0
"""Logarithm of how much more a pose counts that shows the view than one that shows nothing."""
RECENT = 0.97
"""Share of what poses were worth that the next step leaves."""
SHOWN = 0.5
"""Share that what was seen has in where a row believes the view, the rest is what was read."""


@dataclass
class Mind:
    """Of N rows."""

    belief: Belief
    seen: Tensor
    """(N, 8): a weight, and weighted sums of shifts, m, and turns, rad, from the view's middle, and
    of how well poses showed the view."""
    place: Tensor
    """(N,) int64 number of the waypoint that a row is on its way to."""
    steps: Tensor
    """(N,) int64 steps so far."""
    windows: Windows
    choose: int
    """Steps after which a row goes to the best of the spaces that it has seen."""
    further: int
    """Steps after which the space on the other side is not worth the way."""

    @classmethod
    def new(cls, belief: Belief) -> "Mind":
        """Begin episodes with a first belief."""
        count, device = len(belief.placed), belief.placed.device
        none = torch.zeros(count, dtype=torch.int64, device=device)
        seen = torch.zeros(count, 8, device=device)
        windows = Windows.new(belief, seen)
        return cls(belief, seen, none, none.clone(), windows, CHOOSE, FURTHER)

    def learn(self, read: Belief, pose: Pose, worth: Tensor, labels: Tensor, same: Tensor) -> None:
        """Take in what (N,) images show; rows that are not the same episodes begin anew.

        Args:
            read: where they say that the views are.
            pose: where they were taken.
            worth: how well they show the views, 0-1 and more.
            labels: of the views.
            same: (N,) bool.
        """
        for each in (self.place, self.steps, self.seen):
            each.masked_fill_(~same.view(-1, *[1] * (each.dim() - 1)), 0)
        self.windows.forget(~same)
        looks = ~self.windows.travels
        fade = torch.where(self.place > 0, LASTING, FADE)[:, None, None]
        learned = self.belief.after(read, fade).kept(looks, self.belief)
        self.belief = learned.kept(same, read)
        about = middles(labels)
        turn = rotation_vector(matmul3(about.rotation.transpose(1, 2).contiguous(), pose.rotation))
        lies = [torch.ones_like(worth)[:, None], pose.position - about.position, turn]
        weight = torch.exp(SHARP * (worth - 1.0)) * ((self.place > 0) & looks)
        self.seen = RECENT * self.seen + weight[:, None] * torch.cat([*lies, worth[:, None]], 1)

    def search(self, labels: Tensor) -> None:
        """Let rows that have looked all about a window go on to the next, at last to the best."""
        windows, late = self.windows, self.steps >= self.choose
        rows = ((self.place > WAYPOINTS) | late) & ~windows.chosen
        windows.leave(rows, self.belief, self.seen, self.centre(labels), middles(labels))
        enough = late | ((windows.number == 1) & (self.steps > self.further))
        self.belief, self.seen = windows.enter(rows, self.belief, self.seen, enough)
        begun = torch.where(windows.chosen, WAYPOINTS + 1, 0)
        self.place = torch.where(rows, begun, self.place)

    def centre(self, labels: Tensor) -> Pose:
        """Return the (N,) poses where rows believe the views of (N,) labels, as read and seen."""
        read, about = self.belief.among(labels).pose, middles(labels)
        turn = rotation_vector(matmul3(about.rotation.transpose(1, 2).contiguous(), read.rotation))
        lies = torch.cat([read.position - about.position, turn], 1)
        seen = self.seen[:, 1:7] / self.seen[:, :1].clamp_min(1e-20)
        share = torch.where(self.seen[:, :1] > 0.0, SHOWN, 0.0)
        lies = lies + share * (seen - lies)
        rotation = matmul3(about.rotation, axis_angle_to_matrix(lies[:, 3:]))
        return Pose(about.position + lies[:, :3], orthonormalise(rotation))

    def goal(self, centre: Pose, further: int, offsets: Tensor, task: Task) -> Pose:
        """Return the (N,) poses that rows go to, or will after so many waypoints.

        Args:
            centre: as of `centre`.
            further: 0, or waypoints from there.
            offsets: as of `waypoints`.
            task: whose unit steps are taken.
        """
        place = self.place + further
        offset = offsets[torch.where(place < len(offsets), place, 0)]
        turn = axis_angle_to_matrix(offset[:, 3:] * task.step_rotation)
        shift = rotate(centre.rotation, offset[:, :3] * task.step_translation)
        rotation = orthonormalise(matmul3(centre.rotation, turn))
        return Pose(centre.position + shift, rotation)

    def step(self, reached: Tensor) -> None:
        """Count a step; (N,) bool rows have come to where they were going."""
        come = reached & self.windows.travels
        self.windows.travels = self.windows.travels & ~come
        self.place = self.place + (reached & ~come).long()
        self.steps = self.steps + 1
