"""Rigid motions of the probe along a sweep, as matrices and as six numbers.

    frame      0        1        2                  T - 1
               |<--M1---|<--M2---|  ...             to_previous
               |<--M1---|                           to_first[1] = M1
               |<--M1 M2--------|                   to_first[2] = M1 M2

A transform of frame t takes a point that stands still in the probe's frame at t to where it was
seen from at another frame. Lengths are metres, rows are independent of their batch.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    geodesic,
    matmul3,
    rotate,
    rotation_vector,
)


class Motion(NamedTuple):
    """The transforms of a sweep of T frames; those of frame 0 are the identity."""

    to_first: Tensor
    """(T, 4, 4) float64, from each frame's probe to the first frame's, m."""
    to_previous: Tensor
    """(T, 4, 4) float64, from each frame's probe to that of the frame before, m."""


def relative(pose: Pose) -> Motion:
    """Return the motion that (T,) poses of the base frame make."""
    position, rotation = pose.position.double(), pose.rotation.double()
    before = torch.arange(len(position)).sub(1).clamp_min(0)
    return Motion(
        _between(position, rotation, torch.zeros_like(before)),
        _between(position, rotation, before),
    )


def _between(position: Tensor, rotation: Tensor, reference: Tensor) -> Tensor:
    """Return (T, 4, 4) transforms of every frame to the frames of (T,) rows."""
    back = rotation[reference].transpose(-1, -2)
    shift = rotate(back, position - position[reference])
    return matrices(matmul3(back, rotation), shift)


def matrices(rotation: Tensor, shift: Tensor) -> Tensor:
    """Join (…, 3, 3) rotations and (…, 3) shifts into (…, 4, 4) transforms."""
    top = torch.cat([rotation, shift.unsqueeze(-1)], -1)
    last = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, last], -2)


def to_vectors(transforms: Tensor) -> Tensor:
    """Return (…, 6) of (…, 4, 4) transforms: shift, m, and rotation vector, rad.

    The rotation is shorter than half a turn.
    """
    return torch.cat([transforms[..., :3, 3], rotation_vector(transforms[..., :3, :3])], -1)


def from_vectors(vectors: Tensor) -> Tensor:
    """Return the (…, 4, 4) transforms of what `to_vectors` returns."""
    return matrices(axis_angle_to_matrix(vectors[..., 3:]), vectors[..., :3])


def chained(to_previous: Tensor) -> Motion:
    """Return the motion of (T, 4, 4) transforms to the frame before, one after another."""
    to_previous = to_previous.double()
    rotation, shift = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    parts = []
    for step in to_previous:
        shift = shift + rotate(rotation, step[:3, 3])
        rotation = matmul3(rotation, step[:3, :3])
        parts.append(matrices(rotation, shift))
    return Motion(torch.stack(parts), to_previous)


def steps(vectors: Tensor) -> Motion:
    """Return the motion of a sweep whose T - 1 steps are (T - 1, 6), as `to_vectors` has them."""
    still = vectors.new_zeros(1, 6)
    return chained(from_vectors(torch.cat([still, vectors]).double()))


def angles(found: Tensor, true: Tensor) -> Tensor:
    """Return the (…,) angles, rad, between the rotations of (…, 4, 4) transforms."""
    return geodesic(found[..., :3, :3].double(), true[..., :3, :3].double())
