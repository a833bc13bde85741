"""Where a servo believes the target to be, in the base frame, from all that it has read so far.

The target lies still there while the probe moves, so what is read from every image is of the same
pose, and counts by how sure the network was of it, along each of the probe's axes: a precision
matrix for the position and one for the rotation, as in an information filter (Maybeck, Stochastic
Models, Estimation, and Control, 1979). What was read before fades slowly; and what lies far from
the belief counts less (Huber, Robust Estimation of a Location Parameter, 1964), so that one bad
image does not carry it away.
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
"""Share of what is known that the next step leaves, on the way: images from afar mislead alike."""
LASTING = 0.98
"""The same once a row looks about the view."""
HUBER = 2.5
"""Deviations, over three axes, from which on a reading counts less."""
SPREADS = (0.026, 0.026, 0.001), (0.09, 0.09, 0.26)
"""Standard deviations of train patients' targets about a view's middle, along and about the base
frame's axes, m and rad: the probe stands on the skin, and hearts turn about the vertical most."""
BOUNDS = (0.1, 0.1, 0.005), (0.28, 0.28, 0.5)
"""About a view's middle, along and about the same axes, where the targets of all train patients
lie that were looked at: 60 of them, each in five ways. Few others may lie beyond."""
UNITS = 0.02, 0.35
"""Metres and radians whose squares are the units of the precisions."""


class Belief(NamedTuple):
    """Of N rows: the target's pose, and what is known of its position and its rotation."""

    pose: Pose
    placed: Tensor
    """(N, 3, 3) precisions of the position in the base frame's axes, units of `UNITS`."""
    turned: Tensor
    """(N, 3, 3) of the rotation, as rotation vectors in the base frame."""

    def kept(self, rows: Tensor, other: "Belief") -> "Belief":
        """Return this belief in the (N,) bool rows, and another in the rest."""

        def choose(own: Tensor, its: Tensor) -> Tensor:
            return torch.where(rows.view(-1, *[1] * (own.dim() - 1)), own, its)

        pose = Pose(*(choose(a, b) for a, b in zip(self.pose, other.pose, strict=True)))
        return Belief(pose, choose(self.placed, other.placed), choose(self.turned, other.turned))

    def among(self, labels: Tensor) -> "Belief":
        """Return the belief with what is known of (N,) labels before anything is seen.

        Readings far from any heart are guesses; with them alone an agent would be lost.
        """
        about = middles(labels)
        spread = [torch.tensor(each, device=labels.device) for each in SPREADS]
        known = [
            torch.diag((unit / each).square()).expand(len(labels), 3, 3)
            for each, unit in zip(spread, UNITS, strict=True)
        ]
        return Belief(about, *known).after(self, fade=1.0, huber=torch.inf)

    def bounded(self, labels: Tensor) -> "Belief":
        """Return the belief with its pose brought to where the view of (N,) labels can lie.

        Images unlike all of training may say at every step that the view lies further on, and so
        lead an agent about in a circle.
        """
        about = middles(labels)
        away = self.pose.position - about.position
        turn = rotation_vector(
            matmul3(self.pose.rotation, about.rotation.transpose(1, 2).contiguous())
        )
        limits = [torch.tensor(each, device=labels.device) for each in BOUNDS]
        away, turn = (x.clamp(-y, y) for x, y in zip((away, turn), limits, strict=True))
        rotation = matmul3(axis_angle_to_matrix(turn), about.rotation)
        return self._replace(pose=Pose(about.position + away, orthonormalise(rotation)))

    def after(self, read: "Belief", fade: Tensor | float = FADE, huber: float = HUBER) -> "Belief":
        """Return the belief after a reading, which fades what was known before.

        Args:
            read: what an image says.
            fade: share of what is known that is left, (N, 1, 1) if rows differ.
            huber: deviations from which on the reading counts less.
        """
        away = read.pose.position - self.pose.position
        turn = rotation_vector(
            matmul3(read.pose.rotation, self.pose.rotation.transpose(1, 2).contiguous())
        )
        placed, shift = _fused(fade * self.placed, read.placed, away / UNITS[0], huber)
        turned, by = _fused(fade * self.turned, read.turned, turn / UNITS[1], huber)
        rotation = matmul3(axis_angle_to_matrix(by * UNITS[1]), self.pose.rotation)
        pose = Pose(self.pose.position + shift * UNITS[0], orthonormalise(rotation))
        return Belief(pose, placed, turned)


def reading(pose: Pose, way: Tensor, deviation: Tensor) -> Belief:
    """Return what one image says: (N, 6) ways from (N,) poses, and their deviations."""
    place = pose.position + rotate(pose.rotation, way[:, :3])
    rotation = matmul3(pose.rotation, axis_angle_to_matrix(way[:, 3:]))
    precise = [
        _about(pose.rotation, (part / unit).square().clamp_min(1e-6).reciprocal())
        for part, unit in zip((deviation[:, :3], deviation[:, 3:]), UNITS, strict=True)
    ]
    return Belief(Pose(place, orthonormalise(rotation)), *precise)


def _about(rotation: Tensor, precise: Tensor) -> Tensor:
    """Return (N, 3, 3) precisions in the base frame of (N, 3) along (N, 3, 3) axes."""
    return matmul3(rotation * precise.unsqueeze(1), rotation.transpose(1, 2).contiguous())


def _fused(known: Tensor, new: Tensor, away: Tensor, huber: float) -> tuple[Tensor, Tensor]:
    """Return the (N, 3, 3) precisions after a reading, and the (N, 3) that it moves the belief."""
    pull = rotate(new, away)
    deviations = (away * pull).sum(-1).clamp_min(0.0).sqrt()
    counts = (huber / deviations.clamp_min(1e-9)).clamp_max(1.0)
    both = known + counts[:, None, None] * new
    # Not `solve`, which waits for the device to look for singular matrices: these are sums of a
    # positive prior and more. Its result lies column by column, where the sums of a row's three
    # numbers would round by the size of the batch.
    return both, torch.linalg.solve_ex(both, counts[:, None] * pull).result.contiguous()
