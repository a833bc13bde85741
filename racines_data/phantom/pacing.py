"""Sweeps that an arm can follow: moves that its joints cannot make in their time get more of it.

What joints do is known to `racines_envs.robots`, which this package does not import: it is found by
entry points of the group `racines.following`.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.manifest import ADDED, MULTI_PHANTOM
from racines_data.plugins import Plugins

FREE = "free"
"""The robot that is none: a probe that goes where it is told."""
ATTEMPTS = 16
"""Sweeps that are drawn in search of one that an arm can follow."""
MARGIN = 0.8
"""Of the joints' speed that a move may take; the rest is for the hand's tremor."""
_FOLLOWING = Plugins("way to follow", "racines.following", ("__call__",))


class CannotFollow(RacinesError):
    """A sweep leads where the arm cannot be, or faster than it can."""

    def __init__(self, reason: str, lacks: str = ""):
        """Say why, and what it lacks: `time`, `calm`, or a way to get there (empty)."""
        super().__init__(reason)
        self.lacks = lacks


Hurry = Callable[[Pose], Tensor]
"""Of T poses, the share of its joints' speed that an arm takes for each of the (T - 1,) moves.

1 is a joint at its full speed; inf where the arm cannot be.
"""


def hurry_of(robot: str, rate: float) -> Hurry:
    """Return how an arm, by its name or as `module:ARM`, hurries along poses, `rate` a second."""
    hurry = _FOLLOWING.load("joints")
    return lambda pose: hurry(robot, pose, rate)


def recorded_joints(parameters: np.ndarray, robot: str) -> np.ndarray:
    """Return (T, J) float32 joints, rad, of an arm at T recorded poses; NaN where it cannot be.

    Args:
        parameters: (T, 12), as a dataset has them.
        robot: the arm for which the sweep was drawn, of `recorded_robot`.
    """
    pose = parameters_to_pose(torch.from_numpy(parameters).double())
    return joints_of(robot)(pose).float().numpy()


def joints_of(robot: str) -> Callable[[Pose], Tensor]:
    """Return what gives (T, J) joints, rad, of an arm at T poses; NaN where it cannot be."""
    angles = _FOLLOWING.load("angles")
    return lambda pose: angles(robot, pose)


def joint_count(robot: str) -> int:
    """Return how many joints an arm has.

    Raises:
        RacinesError: no such arm, or a package that it needs is not installed.
    """
    return joints_of(robot)(Pose(torch.zeros(0, 3), torch.zeros(0, 3, 3))).shape[1]


def recorded_robot(manifest: Mapping[str, Any], config: str) -> str:
    """Return the arm for which the sweeps of a config were drawn, `free` for none.

    The manifest is the config's own, of `config_manifest`.
    """
    recipe = manifest.get("recipe") or {}
    told = recipe.get(MULTI_PHANTOM if config == MULTI_PHANTOM else "settings") or {}
    return (told.get("settings" if config in ADDED else "acquisition") or {}).get("robot", FREE)


Sweep = TypeVar("Sweep")


def first_followed(draw: Callable[[int], Sweep], field: str, remedies: Mapping[str, str]) -> Sweep:
    """Return the first sweep, of those drawn by attempt, that an arm can follow.

    Raises:
        RacinesError: none of them, with the field that names the arm and the remedy of what the
            last one lacked.
    """
    last = CannotFollow("no sweep was drawn")
    for attempt in range(ATTEMPTS):
        try:
            return draw(attempt)
        except CannotFollow as error:
            last = error
    remedy = f": {remedies[last.lacks]}" if last.lacks in remedies else ""
    raise RacinesError(f"{field}: {last}{remedy}") from last


def paced(shares: Tensor, hurry: Hurry, length: int, poses: Callable[[Tensor], Pose]) -> Tensor:
    """Return (L,) shares of time of L moves such that no joint has to turn too fast.

    What a move takes in joint angles does not hang on its time, so the least time of each follows
    from one look; what is left of the sweep's time goes to the other moves in proportion.

    Args:
        shares: (L,) as the hand would divide the time.
        hurry: of the arm that has to follow.
        length: frames of the sweep.
        poses: gives the (length,) poses of the path by shares.

    Raises:
        CannotFollow: the arm does not reach the path, or the sweep is too short for it.
    """
    shares = shares / shares.sum()
    taken = hurry(poses(shares)).to(shares) / MARGIN
    if not bool(torch.isfinite(taken).all()):
        raise CannotFollow("a sweep leads where the arm cannot be")
    ends = torch.cat([shares.new_zeros(1), shares.cumsum(0)])
    steps = torch.linspace(0.0, 1.0, length)
    # A step that begins in one move and ends in the next counts for both.
    before, after = steps[:-1].unsqueeze(0), steps[1:].unsqueeze(0)
    within = (after > ends[:-1].unsqueeze(1)) & (before < ends[1:].unsqueeze(1))
    least = shares * torch.where(within, taken, 0.0).amax(1)
    needed = float(least.sum())
    if needed > 1.0:
        needs = f"a sweep of {length} frames takes the arm {needed * length:.0f}"
        raise CannotFollow(needs, "time")
    return _fill(shares, least)


def check_followed(pose: Pose, hurry: Hurry) -> None:
    """Raise `CannotFollow` where an arm cannot follow (T,) poses."""
    fastest = float(hurry(pose).max())
    if not fastest <= 1.0:
        told = f"the hand's tremor takes the arm to {fastest:.2f} of its speed"
        raise CannotFollow(told, "calm")


def _fill(shares: Tensor, least: Tensor) -> Tensor:
    """Return shares that add up to 1, none below its least, the others scaled alike."""
    held, scale = torch.zeros_like(shares, dtype=torch.bool), 1.0
    for _ in range(len(shares)):
        scale = (1.0 - float(least[held].sum())) / max(float(shares[~held].sum()), 1e-12)
        short = ~held & (shares * scale < least)
        if not bool(short.any()):
            break
        held |= short
    return torch.where(held, least, shares * scale)
