"""Where a servo believes the target to be, in the base frame, from all that it has read so far.

The target lies still there while the probe moves, so what is read from every image is of the same
pose, and counts by how sure the network was of it. Errors of neighbouring images go together, so
what was read before fades; and what lies far from the belief counts less (Huber, Robust Estimation
of a Location Parameter, 1964), so that one bad image does not carry it away.
"""

from typing import NamedTuple

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
from racines_envs.task.tiers import middles

FADE = 0.85
"""Share of what is known that the next step leaves."""
HUBER = 1.5
"""Deviations from which on a reading counts less."""
FARTHEST = 0.07, 0.55
"""Metres and radians from a view's middle within which nearly all train patients' targets lie."""
UNITS = 0.02, 0.35
"""Metres and radians whose squares are the units of the precisions."""


class Belief(NamedTuple):
    """Of N rows: the target's pose, and the precisions of its position and rotation, (N,)."""

    pose: Pose
    placed: Tensor
    turned: Tensor

    def kept(self, rows: Tensor, other: "Belief") -> "Belief":
        """Return this belief in the (N,) bool rows, and another in the rest."""

        def choose(own: Tensor, its: Tensor) -> Tensor:
            return torch.where(rows.view(-1, *[1] * (own.dim() - 1)), own, its)

        pose = Pose(*(choose(a, b) for a, b in zip(self.pose, other.pose, strict=True)))
        return Belief(pose, choose(self.placed, other.placed), choose(self.turned, other.turned))

    def confined(self, labels: Tensor) -> "Belief":
        """Return the belief no farther from the middles of (N,) labels than targets lie.

        Readings far from any heart are guesses that point ever farther: who follows them is lost.
        """
        about = middles(labels)
        shift = self.pose.position - about.position
        turn = rotation_vector(matmul3(about.rotation.transpose(1, 2), self.pose.rotation))
        shift, turn = (
            part * (most / part.norm(dim=-1, keepdim=True).clamp_min(most))
            for part, most in zip((shift, turn), FARTHEST, strict=True)
        )
        rotation = orthonormalise(matmul3(about.rotation, axis_angle_to_matrix(turn)))
        return Belief(Pose(about.position + shift, rotation), self.placed, self.turned)

    def after(self, read: "Belief") -> "Belief":
        """Return the belief after a reading, which fades what was known before."""
        shift = read.pose.position - self.pose.position
        turn = rotation_vector(matmul3(self.pose.rotation.transpose(1, 2), read.pose.rotation))
        placed, near = _share(FADE * self.placed, read.placed, shift.norm(dim=-1) / UNITS[0])
        turned, like = _share(FADE * self.turned, read.turned, turn.norm(dim=-1) / UNITS[1])
        rotation = matmul3(self.pose.rotation, axis_angle_to_matrix(turn * like[:, None]))
        pose = Pose(self.pose.position + near[:, None] * shift, orthonormalise(rotation))
        return Belief(pose, placed, turned)


def reading(pose: Pose, way: Tensor, deviation: Tensor) -> Belief:
    """Return what one image says: (N, 6) ways from (N,) poses, and their deviations."""
    place = pose.position + rotate(pose.rotation, way[:, :3])
    rotation = matmul3(pose.rotation, axis_angle_to_matrix(way[:, 3:]))
    precise = [
        (part.square().mean(-1) / unit**2).clamp_min(1e-6).reciprocal()
        for part, unit in zip((deviation[:, :3], deviation[:, 3:]), UNITS, strict=True)
    ]
    return Belief(Pose(place, orthonormalise(rotation)), *precise)


def _share(known: Tensor, new: Tensor, away: Tensor) -> tuple[Tensor, Tensor]:
    """Return the precision after a reading, and by which share it moves the belief."""
    deviations = away * (1.0 / (1.0 / known + 1.0 / new)).sqrt()
    new = new * (HUBER / deviations.clamp_min(HUBER))
    return known + new, new / (known + new)
