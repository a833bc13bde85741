"""How far a pose is from showing the target view: from the nearest pose that truly shows it.

An oracle says whether a pose shows a view, not how far off it is. So poses between the pose and the
nominal one, which shows the view, are judged: any share of the shift with any share of the turn, on
a grid, then on a finer one about the nearest that shows the view, near in unit steps of the task.
What is found shows the view, so its distance is an upper bound: a pose that no such share makes may
be nearer. docs/environments.md says how much nearer.
"""

import torch
from torch import Tensor

from racines_data.geometry import Pose, geodesic, orthonormalise
from racines_data.world import World
from racines_envs.task.starts import first_max

COARSE, FINE = 8, 4
"""Shares judged of the shift and of the turn: 9 × 9, then 5 × 5 within a step of the first grid, so
that each share is known to 1/32."""
ROWS = 64
"""Poses searched from at a time: bounds the memory."""


def nearest_showing(
    world: World, pose: Pose, target: Pose, label: int, units: tuple[float, float]
) -> Pose:
    """Return (N,) poses that show a view, each near to one of (N,) poses; see the module.

    Args:
        world: What judges the poses; or knows better, by its `own_nearest`.
        pose: Where the probes are.
        target: The nominal pose, a batch of one. It is the answer where nothing else is found.
        label: The label of the view.
        units: What counts as one step of shift, m, and of turn, rad.
    """
    own = world.own_nearest(pose, label, units)
    if own is not None:
        return own
    parts = zip(*(x.split(ROWS) for x in pose), strict=True)
    found = [_search(world, Pose(*part), target, label, units) for part in parts]
    return Pose(*(torch.cat(column) for column in zip(*found, strict=True)))


def _search(world: World, pose: Pose, target: Pose, label: int, units: tuple[float, float]) -> Pose:
    device = pose.position.device
    metres = (target.position - pose.position).norm(dim=-1, keepdim=True)
    radians = geodesic(pose.rotation, target.rotation)[:, None]

    def best(shares: Tensor) -> Tensor:
        """Return each row's (2,) shares, of its (K, 2), that cost least and show the view.

        Where none shows it: those that cost most, the nominal pose of a grid that goes all the way.
        """
        shown = world.judge(_between(pose, target, shares)).view.view(shares.shape[:2]) == label
        cost = shares[..., 0] * (metres / units[0]) + shares[..., 1] * (radians / units[1])
        chosen = first_max(-torch.where(shown, cost, 1e6 - cost))
        return shares.gather(1, chosen[:, None, None].expand(-1, 1, 2)).squeeze(1)

    coarse = best(_grid(COARSE, device).expand(len(pose.position), -1, -1))
    finer = coarse[:, None] - _grid(FINE, device) / COARSE
    return _between(pose, target, best(finer.clamp_min(0.0))[:, None])


def _grid(steps: int, device: torch.device) -> Tensor:
    """Return ((steps + 1)², 2) shares of shift and turn."""
    line = torch.linspace(0.0, 1.0, steps + 1, device=device)
    return torch.cartesian_prod(line, line)


def _between(pose: Pose, target: Pose, shares: Tensor) -> Pose:
    """Return the (N × K) poses at (N, K, 2) shares of the shift and of the turn to the target."""
    shift, turn = shares[..., 0, None], shares[..., 1, None, None]
    position = pose.position[:, None] + shift * (target.position - pose.position)[:, None]
    # Along the chord between the matrices: near enough to the shortest turn, and never undefined
    # but at exactly half a turn.
    turned = pose.rotation[:, None] + turn * (target.rotation - pose.rotation)[:, None]
    turned = torch.where(turn > 0.0, orthonormalise(turned), pose.rotation[:, None])
    return Pose(position.flatten(0, 1), turned.flatten(0, 1))
