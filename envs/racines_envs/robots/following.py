"""Who carries the probe in an environment: nobody, or an arm whose joints have to follow."""

from functools import cache
from typing import Protocol

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.world import STEP_SECONDS
from racines_envs.robots.arm import FREE, Arm, get_arm
from racines_envs.robots.kinematics import Kinematics
from racines_envs.task.sensing import all_hold

FROM_HOME, A_STEP = 40, 4
"""Iterations that bring an arm from home to a start, and from a pose to the next."""
SINGULAR = 0.02
"""Closest to a singularity that a step may lead, m/s of the tip for 1 rad/s of the joints."""


class Robot(Protocol):
    """Carries N probes."""

    name: str
    joints: int

    def begin(self, pose: Pose) -> Tensor:
        """Return the (N, J) joints, rad, at which probes stand at poses; from home.

        Raises:
            RacinesError: a pose that it cannot take.
        """
        ...

    def follow(self, joints: Tensor, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return (N, J) joints one step later, at poses, and (N,) whether it can follow there."""
        ...


class FreeProbe:
    """A probe that nothing carries: it has no joints, and follows anywhere."""

    name, joints = FREE, 0

    def begin(self, pose: Pose) -> Tensor:
        """Return (N, 0) joints."""
        return pose.position.new_zeros(len(pose.position), 0, dtype=torch.float64)

    def follow(self, joints: Tensor, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return them, and that it follows."""
        return joints, torch.ones(len(joints), dtype=torch.bool, device=joints.device)


class ArmRobot:
    """An arm: within its joints' limits and speeds, in reach, and away from singularities."""

    def __init__(self, arm: Arm, device: torch.device | str) -> None:
        """Read the arm's links and limits."""
        self.name, self.joints, self.kinematics = arm.name, len(arm.links), Kinematics(arm, device)
        table = {"dtype": torch.float64, "device": torch.device(device)}
        self._low, self._high = torch.tensor(arm.limits, **table).unbind(1)
        self.step = torch.tensor(arm.speeds, **table) * STEP_SECONDS
        """(J,) rad, the farthest that each joint turns in one step."""
        self._home = torch.tensor(arm.home, **table)

    def begin(self, pose: Pose) -> Tensor:
        """Return the (N, 6) joints of starts; those out of reach are refused."""
        home = self._home.expand(len(pose.position), self.joints)
        joints, there = self.kinematics.solve(pose, home, FROM_HOME)
        there = there & self._allows(joints)
        if not all_hold(there):
            at = [round(value, 3) for value in pose.position[~there][0].tolist()]
            raise RacinesError(
                f"robot {self.name!r} cannot take the start at {at} m: start within its reach, or "
                f"use robot={FREE!r}"
            )
        return joints

    def follow(self, joints: Tensor, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return joints one step later, and whether limits, speeds and reach let it go there.

        A step that leads away from a singularity is let through, however near it is.
        """
        later, there = self.kinematics.solve(pose, joints, A_STEP)
        slow = ((later - joints).abs() <= self.step).all(1)
        reach = self.kinematics.reach(later)
        away = (reach >= SINGULAR) | (reach >= self.kinematics.reach(joints))
        return later, there & slow & away & self._allows(later)

    def angles(self, pose: Pose) -> Tensor:
        """Return the (T, J) joints to which the arm comes from home for each of T poses.

        NaN where it cannot be, or is too close to a singularity.
        """
        home = self._home.expand(len(pose.position), self.joints)
        joints, there = self.kinematics.solve(pose, home, FROM_HOME)
        there &= self._allows(joints) & (self.kinematics.reach(joints) >= SINGULAR)
        return joints.where(there.unsqueeze(1), torch.nan)

    def hurry(self, pose: Pose, rate: float) -> Tensor:
        """Return (T - 1,) of T poses, `rate` a second: the share of its speed that a move takes.

        Of joints as `angles` has them; inf from or to where the arm cannot be.
        """
        turned = self.angles(pose).diff(dim=0).abs() * rate * STEP_SECONDS
        return (turned / self.step).amax(1).nan_to_num(torch.inf)

    def _allows(self, joints: Tensor) -> Tensor:
        return ((joints >= self._low) & (joints <= self._high)).all(1)


def hurry(robot: str, pose: Pose, rate: float) -> Tensor:
    """Return (T - 1,) of T poses, `rate` a second: the share of an arm's speed that a move takes.

    See `ArmRobot.hurry`; the arm is told by its name, or as `module:ARM`.

    Raises:
        RacinesError: no such arm, or `pytorch_kinematics` is not installed.
    """
    return _shared_robot(robot).hurry(pose, rate)


def angles(robot: str, pose: Pose) -> Tensor:
    """Return (T, J) joints, rad, of an arm at T poses; see `ArmRobot.angles`.

    Raises:
        RacinesError: as `hurry`.
    """
    return _shared_robot(robot).angles(pose)


@cache
def _shared_robot(name: str) -> ArmRobot:
    return ArmRobot(get_arm(name), "cpu")


def make_robot(robot: str | Arm, device: torch.device | str) -> FreeProbe | ArmRobot:
    """Return what carries the probes: `free`, or an arm by name, `module:ARM` or itself.

    Raises:
        RacinesError: an unknown name, or `pytorch_kinematics` is not installed.
    """
    if robot == FREE:
        return FreeProbe()
    return ArmRobot(get_arm(robot) if isinstance(robot, str) else robot, device)
