"""Joints to poses and back, for many rows at once, in float64.

Poses follow from joints by `pytorch_kinematics`. Joints follow from poses by damped least squares
(Wampler, 1986) from where they stand: steps are small, so a few iterations end far below what a
sensor could tell.
"""

from typing import Any

import torch
from torch import Tensor

from racines_data.extras import needed
from racines_data.geometry import Pose
from racines_envs.robots.arm import BASE, TIP, Arm
from racines_models.networks.batching import in_fixed_batches

DAMPING = 1e-6
LONGEST = 0.4
"""Greatest change of a joint in one iteration, rad."""
ROWS = 32
"""Rows that are taken at a time: sines are rounded otherwise in what is left of a vector."""
CLOSE = 1e-7
"""What is left, m and rad, when a pose counts as reached."""


class Kinematics:
    """Forward and inverse kinematics of one arm and its probe."""

    def __init__(self, arm: Arm, device: torch.device | str = "cpu") -> None:
        """Read the arm's links.

        Raises:
            RacinesError: `pytorch_kinematics` is not installed.
        """
        needed("pytorch_kinematics", f"robot {arm.name!r}")
        from pytorch_kinematics import build_serial_chain_from_urdf

        chain = build_serial_chain_from_urdf(arm.urdf().encode(), TIP, BASE)
        self._chain: Any = chain.to(dtype=torch.float64, device=torch.device(device))
        self.arm, self.device = arm, torch.device(device)

    def forward(self, joints: Tensor) -> Pose:
        """Return the poses of the probe's tip, m, at (N, J) joints, rad."""
        joints = joints.to(self.device, torch.float64)
        return Pose(*in_fixed_batches(lambda held: tuple(self._look(held)[0]), joints, size=ROWS))

    def solve(self, pose: Pose, joints: Tensor, iterations: int) -> tuple[Tensor, Tensor]:
        """Return (N, J) joints at which the probe has a pose, and (N,) whether it does.

        Args:
            pose: wanted, of N rows.
            joints: (N, J) from where the arm goes there.
            iterations: how often the joints are bettered.
        """
        position, rotation = (part.to(self.device, torch.float64) for part in pose)

        def better(position: Tensor, rotation: Tensor, joints: Tensor) -> tuple[Tensor, Tensor]:
            for _ in range(iterations):
                joints = joints + self._towards(position, rotation, joints)
            left = _apart(self._look(joints)[0], position, rotation).abs().amax(1)
            return joints, left < CLOSE

        start = joints.to(self.device, torch.float64)
        return in_fixed_batches(better, position, rotation, start, size=ROWS)

    def points(self, joints: Tensor) -> Tensor:
        """Return (N, J + 3, 3) points, m, for pictures: base, joints, flange, and tip."""
        frames = self._chain.forward_kinematics(joints, end_only=False)
        names = [BASE, *(f"link{place + 1}" for place in range(joints.shape[1])), TIP]
        at = [frames[name].get_matrix()[:, :3, 3].expand(len(joints), 3) for name in names]
        return torch.stack([*at, self.forward(joints).position], 1)

    def reach(self, joints: Tensor) -> Tensor:
        """Return (N,) how far (N, J) joints are from a singularity: 0 is one.

        The least singular value of the Jacobian: m/s of the tip for 1 rad/s of the joints, where
        the motion is hardest.
        """

        def least(joints: Tensor) -> Tensor:
            return torch.linalg.svdvals(self._look(joints)[1])[:, -1]

        return in_fixed_batches(least, joints.to(self.device, torch.float64), size=ROWS)

    def _towards(self, position: Tensor, rotation: Tensor, joints: Tensor) -> Tensor:
        at, jacobian = self._look(joints)
        error = _apart(at, position, rotation)
        square = (jacobian.unsqueeze(-1) * jacobian.mT.unsqueeze(-3)).sum(-2)  # row by row
        damped = square + DAMPING * torch.eye(6, dtype=square.dtype, device=square.device)
        along = torch.linalg.solve(damped, error)
        change = (jacobian.mT * along.unsqueeze(1)).sum(-1)
        return change * (LONGEST / change.abs().amax(1, keepdim=True).clamp_min(LONGEST))

    def _look(self, joints: Tensor) -> tuple[Pose, Tensor]:
        """Return the poses of the tip and the (N, 6, J) Jacobian there, in the base frame."""
        jacobian, frame = self._chain.jacobian(joints, ret_eef_pose=True)
        rotation, flange = frame[:, :3, :3], frame[:, :3, 3]
        arm = self.arm.tool * rotation[..., 2]
        turning = jacobian[:, 3:].mT
        moved = torch.linalg.cross(turning, arm.unsqueeze(1).expand_as(turning)).mT
        at_tip = torch.cat([jacobian[:, :3] + moved, jacobian[:, 3:]], 1)
        return Pose(flange + arm, rotation), at_tip


def _apart(at: Pose, position: Tensor, rotation: Tensor) -> Tensor:
    """Return the (N, 6) twist from poses to others, base frame: m, then rad about an axis."""
    turn = (rotation.unsqueeze(-2) * at.rotation.unsqueeze(-3)).sum(-1)  # R_to R_at^T
    skew = 0.5 * (turn - turn.mT)
    sine = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], -1)
    cosine = 0.5 * (turn.diagonal(dim1=1, dim2=2).sum(1) - 1.0)
    size = sine.norm(dim=1)
    angle = torch.atan2(size, cosine)
    about = sine * (angle / size.clamp_min(1e-12)).unsqueeze(1)
    return torch.cat([position - at.position, about], 1)
