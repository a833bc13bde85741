"""Poses around a task's nominal pose: where episodes start, and the nearest that shows the view."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, geodesic, matmul3, orthonormalise
from racines_data.randomness import derive, uniform
from racines_data.world import Workspace, World
from racines_envs.task.tasks import Task

TRIES = 8
COARSE, FINE = 8, 4
"""Shares judged of the shift and of the turn: 9 × 9, then 5 × 5 within a step of the first grid, so
that each share is known to 1/32."""
ROWS = 64  # poses searched from at a time: bounds the memory
_STREAM = 101
_EVALUATION = 0x5EED
_VALIDATION = 0x7A11
_ON_PATIENTS = 0xA7157


def evaluation_seeds(count: int, seed: int = 0) -> Tensor:
    """Return (count,) seeds of the fixed start set of evaluations; training never draws them."""
    return derive(torch.full((count,), _EVALUATION), seed, torch.arange(count))


def patient_seeds(patients: Sequence[int], starts: int, seed: int = 0) -> Tensor:
    """Return (patients × starts,) seeds of the fixed starts on each patient, one after another."""
    each = torch.tensor(patients).repeat_interleave(starts)
    start = torch.arange(starts).repeat(len(patients))
    return derive(torch.full_like(each, _ON_PATIENTS), seed, each, start)


def validation_seeds(count: int, seed: int = 0) -> Tensor:
    """Return (count,) seeds of the starts on which a policy is chosen while it trains."""
    return derive(torch.full((count,), _VALIDATION), seed, torch.arange(count))


def draw_starts(
    task: Task, world: World, target: Pose, seeds: Tensor, labels: Tensor | None = None
) -> Pose:
    """Draw one start a seed, (N,), inside the workspace and outside the target view.

    A world that knows where it can start, as recordings do, draws the starts itself. Else the
    offset along the block's top has a uniform distance and direction, and is mirrored along an axis
    on which it would leave the workspace; the height is uniform, and the rotation has a uniform
    angle about a uniform axis. The first of eight such draws that lies in the workspace and does
    not show the view is taken; else the first in the workspace; else the pose they are drawn about.

    Args:
        task: Says how far away, and which view unless there are `labels`.
        world: The one heart, or the scene of N rows.
        target: What is drawn about: one pose, or (N,).
        seeds: (N,) int64.
        labels: (N,) of the views that may not be shown.
    """
    if not task.any_view:
        limits = task.start_distance, task.start_angle
        own = world.own_starts(task.target, target, seeds, *limits)
        if own is not None:
            return own
    count, workspace = seeds.shape[0], world.workspace
    each = torch.arange(count, device=seeds.device).repeat_interleave(TRIES)
    about = Pose(*(part.expand(count, *part.shape[1:])[each] for part in target))
    shift, turn = _offsets(task, uniform(seeds, TRIES * 6, _STREAM).view(count * TRIES, 6))
    place = about.position + shift
    beyond = (place < workspace.position_min) | (place > workspace.position_max)
    place = torch.where(beyond, about.position - shift, place)
    drawn = Pose(place, matmul3(about.rotation, turn))
    inside = workspace.contains(drawn)
    labels = torch.full_like(seeds, task.target) if labels is None else labels
    membership = world.at(each).judge(drawn).membership
    unseen = membership.gather(1, labels[each].unsqueeze(1)).squeeze(1) < 0.5
    worth = (2 * inside + (inside & unseen)).view(count, TRIES)
    row = torch.arange(count, device=seeds.device) * TRIES + first_max(worth)
    some = (worth > 0).any(1)
    return Pose(
        torch.where(some[:, None], drawn.position[row], target.position),
        torch.where(some[:, None, None], drawn.rotation[row], target.rotation),
    )


def check_starts(pose: Pose, count: int, workspace: Workspace, device: torch.device | str) -> Pose:
    """Return (count,) given start poses on the device, if all are finite and in the workspace."""
    pose = pose.to(device)
    shape = tuple(pose.position.shape)
    if shape != (count, 3):
        raise RacinesError(f"start positions have shape {shape}: give ({count}, 3)")
    if not all(bool(torch.isfinite(x).all()) for x in pose):
        raise RacinesError("a start pose is not finite: every value must be a number")
    outside = ~workspace.contains(pose)
    if bool(outside.any()):
        row = int(outside.nonzero()[0])
        edges = (workspace.position_min, workspace.position_max)
        low, high = (", ".join(f"{x:.3f}" for x in edge.tolist()) for edge in edges)
        where = ", ".join(f"{x:.4f}" for x in pose.position[row].tolist())
        raise RacinesError(
            f"start pose {row} at ({where}) m is outside the workspace: positions from ({low}) "
            f"to ({high}) m, and its tilt and yaw limits"
        )
    return pose


def first_max(values: Tensor) -> Tensor:
    """Return the (N,) index of each row's first maximum; argmax alone may give any of them."""
    index = torch.arange(values.shape[1], device=values.device)
    greatest = values.max(1, keepdim=True).values
    return torch.where(values == greatest, index, values.shape[1]).amin(1)


def _offsets(task: Task, u: Tensor) -> tuple[Tensor, Tensor]:
    """Turn (M, 6) uniform numbers into (M, 3) shifts, base frame, and (M, 3, 3) turns."""

    def between(limits: tuple[float, float], x: Tensor) -> Tensor:
        return limits[0] + (limits[1] - limits[0]) * x

    distance, direction = between(task.start_distance, u[:, 0]), 2.0 * math.pi * u[:, 1]
    height = between(task.start_height, u[:, 2])
    shift = torch.stack([distance * direction.cos(), distance * direction.sin(), height], -1)
    cos, turn = 2.0 * u[:, 3] - 1.0, 2.0 * math.pi * u[:, 4]
    sin = (1.0 - cos.square()).clamp_min(0.0).sqrt()
    axis = torch.stack([sin * turn.cos(), sin * turn.sin(), cos], -1)
    return shift, axis_angle_to_matrix(axis * between(task.start_angle, u[:, 5]).unsqueeze(-1))


def nearest_showing(
    world: World, pose: Pose, target: Pose, label: int | Tensor, units: tuple[float, float]
) -> Pose:
    """Return (N,) poses that show a view, each near, in `units` of m and rad, to one of (N,) poses.

    An oracle says whether a pose shows a view, not how far off it is. So poses between a pose and
    the nominal one (`target`, one or (N,)), which shows the view, are judged: any share of the
    shift with any share of the turn, on a grid, then on a finer one about the nearest that shows
    the view. What is found shows the view, so its distance is an upper bound: a pose that no such
    share makes may be nearer; docs/environments.md says how much. A world may know better, by its
    `own_nearest`. `label` is the view's, or (N,) of each row's.
    """
    count, device = len(pose.position), pose.position.device
    if not isinstance(label, Tensor):
        own = world.own_nearest(pose, label, units)
        if own is not None:
            return own
        label = torch.full((count,), label, device=device)
    target = Pose(*(part.expand(count, *part.shape[1:]) for part in target))
    found = [
        _search(world.at(rows), _rows(pose, rows), _rows(target, rows), label[rows], units)
        for rows in torch.arange(count, device=device).split(ROWS)
    ]
    return Pose(*(torch.cat(column) for column in zip(*found, strict=True)))


def _rows(pose: Pose, rows: Tensor) -> Pose:
    return Pose(*(part[rows] for part in pose))


def _search(
    world: World, pose: Pose, target: Pose, label: Tensor, units: tuple[float, float]
) -> Pose:
    device = pose.position.device
    metres = (target.position - pose.position).norm(dim=-1, keepdim=True)
    radians = geodesic(pose.rotation, target.rotation)[:, None]

    def best(shares: Tensor) -> Tensor:
        """Return each row's (2,) shares, of its (K, 2), that cost least and show the view.

        Where none shows it: those that cost most, the nominal pose of a grid that goes all the way.
        """
        each = torch.arange(len(label), device=device).repeat_interleave(shares.shape[1])
        view = world.at(each).judge(_between(pose, target, shares)).view
        shown = view.view(shares.shape[:2]) == label[:, None]
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
