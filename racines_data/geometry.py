"""Poses of the probe in the robot base frame: metres, radians, extrinsic xyz Euler angles.

The probe frame has x to the right of the image, y out of the image plane (elevation) and z along
the central beam, into the block. A probe that looks straight down has rotation_x = ±π.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

POSITION, ROTATION = slice(6, 9), slice(9, 12)  # of the twelve parameters


class Pose(NamedTuple):
    """A batch of probe poses."""

    position: Tensor
    """(B, 3) metres, base frame."""
    rotation: Tensor
    """(B, 3, 3) columns are the probe's axes in the base frame."""

    def to(self, device: torch.device | str) -> "Pose":
        """Return the pose on another device."""
        return Pose(self.position.to(device), self.rotation.to(device))


def euler_to_matrix(angles: Tensor) -> Tensor:
    """Turn (…, 3) extrinsic xyz angles into (…, 3, 3) matrices, R = Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = angles.cos().unbind(-1), angles.sin().unbind(-1)
    rows = [
        torch.stack([cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx], -1),
        torch.stack([sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx], -1),
        torch.stack([-sy, cy * sx, cy * cx], -1),
    ]
    return torch.stack(rows, -2)


def matrix_to_euler(rotation: Tensor) -> Tensor:
    """Turn (…, 3, 3) matrices into (…, 3) extrinsic xyz angles, rotation_y in [-π/2, π/2]."""
    x = torch.atan2(rotation[..., 2, 1], rotation[..., 2, 2])
    y = torch.asin(rotation[..., 2, 0].neg().clamp(-1.0, 1.0))
    z = torch.atan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return torch.stack([x, y, z], -1)


def axis_angle_to_matrix(vector: Tensor) -> Tensor:
    """Turn (…, 3) rotation vectors (axis times angle) into (…, 3, 3) matrices (Rodrigues)."""
    angle = vector.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    x, y, z = (vector / angle).unbind(-1)
    cos, sin = angle.squeeze(-1).cos(), angle.squeeze(-1).sin()
    rest = 1.0 - cos
    rows = [
        torch.stack([cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin], -1),
        torch.stack([y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin], -1),
        torch.stack([z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest], -1),
    ]
    return torch.stack(rows, -2)


def matmul3(a: Tensor, b: Tensor) -> Tensor:
    """Multiply (…, 3, 3) matrices elementwise, so that a row's result ignores its batch."""
    return (a.unsqueeze(-1) * b.unsqueeze(-3)).sum(-2)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the products of (…, 3) vectors: the same bits as a sum over the axis, in less time."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def rotate(rotation: Tensor, vector: Tensor) -> Tensor:
    """Rotate (…, 3) vectors by (…, 3, 3) matrices, row results independent of the batch."""
    return dot(rotation, vector.unsqueeze(-2))


def orthonormalise(rotation: Tensor) -> Tensor:
    """Remove drift from (…, 3, 3) rotations by Gram-Schmidt, z axis first."""
    z = torch.nn.functional.normalize(rotation[..., 2], dim=-1)
    x = rotation[..., 0] - (rotation[..., 0] * z).sum(-1, keepdim=True) * z
    x = torch.nn.functional.normalize(x, dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def geodesic(a: Tensor, b: Tensor) -> Tensor:
    """Return the angle in radians, (…,), between (…, 3, 3) rotations."""
    # From the chord |A - B|_F = 2√2 sin(θ/2): well-conditioned at small angles, as acos is not.
    chord = (a - b).square().sum((-2, -1)).sqrt()
    return 2.0 * torch.asin((chord / (2.0 * 2.0**0.5)).clamp(0.0, 1.0))


def rotation_vector(rotation: Tensor) -> Tensor:
    """Return the (…, 3) rotation vectors, rad, of (…, 3, 3) rotations short of half a turn."""
    flipped = rotation - rotation.transpose(-1, -2)
    axis = torch.stack([flipped[..., 2, 1], flipped[..., 0, 2], flipped[..., 1, 0]], -1)
    angle = geodesic(torch.eye(3, device=rotation.device).expand_as(rotation), rotation)
    return axis / axis.norm(dim=-1, keepdim=True).clamp_min(1e-9) * angle.unsqueeze(-1)


def pose_keys(pose: Pose, metres_per_radian: float) -> Tensor:
    """Return (B, 12) keys of poses, m, whose Euclidean distance is that of the poses.

    It is sqrt(|Δp|² + (w · 2 sin(θ/2))²) with Δp the shift, θ the angle between the rotations, and
    w what a turn weighs against a shift: the rotation matrix is scaled by w/√2.
    """
    weight = metres_per_radian / math.sqrt(2.0)
    return torch.cat([pose.position, weight * pose.rotation.flatten(-2)], -1)


def parameters_to_pose(parameters: Tensor) -> Pose:
    """Read the pose off (B, 12) parameters."""
    return Pose(parameters[..., POSITION], euler_to_matrix(parameters[..., ROTATION]))


def pose_to_parameters(pose: Pose, wrench: Tensor | None = None) -> Tensor:
    """Join poses and (B, 6) force and torque (zero if absent) into (B, 12) parameters."""
    if wrench is None:
        wrench = pose.position.new_zeros((*pose.position.shape[:-1], 6))
    return torch.cat([wrench, pose.position, matrix_to_euler(pose.rotation)], -1)


def rotation_6d(rotation: Tensor) -> Tensor:
    """Encode (…, 3, 3) rotations continuously as their first two columns, (…, 6).

    Source: Zhou et al., On the Continuity of Rotation Representations in Neural Networks, 2019.
    """
    return torch.cat([rotation[..., 0], rotation[..., 1]], -1)


def matrix_from_6d(encoded: Tensor) -> Tensor:
    """Turn (…, 6) encoded rotations, exact or not, into (…, 3, 3) matrices by Gram-Schmidt."""
    x = torch.nn.functional.normalize(encoded[..., :3], dim=-1)
    y = encoded[..., 3:] - (encoded[..., 3:] * x).sum(-1, keepdim=True) * x
    y = torch.nn.functional.normalize(y, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)
