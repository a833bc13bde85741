"""Sweeps as a robot steered by a joystick makes them, one trajectory at a time.

    height ──╮                                          ╭── leave
             ╰─ touch ─── overshoot ─ correct ─ dwell ──╯
             approach      search       the view is held

A path is a chain of way-points joined by minimum-jerk moves (Flash & Hogan 1985), with tremor of
the hand on top. Coordinates are x, y, z and the Euler angles with rotation_x measured from straight
down, in which the probe's leaning and turning are nearly independent.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from racines_data.geometry import Pose, euler_to_matrix, matrix_to_euler
from racines_data.phantom.anatomy import anatomy_views
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.model import Phantom
from racines_data.phantom.pacing import (
    FREE,
    check_followed,
    first_followed,
    hurry_of,
    paced,
)
from racines_data.phantom.truth import deepest
from racines_data.randomness import derive, normal, sample_seeds, uniform
from racines_data.views import RANDOM
from racines_data.world import Workspace


@dataclass(frozen=True)
class AcquisitionConfig:
    """How the phantom is scanned."""

    frames: int = 6000  # in all; the paper has 144,668
    seed: int = 0
    sessions: int = 3  # each has its operator: speed, tremor and pressure differ
    shortest: int = 90  # frames of a trajectory
    longest: int = 150
    rate: float = 25.0  # frames a second
    random_share: float = 0.16  # of trajectories (CACTUS: 6,021 of 37,736 images)
    tremor: float = 0.0004  # of the hand, m (and the same number of degrees a millimetre)
    pose_noise: float = 0.00005  # of the measured position, m; a tenth of it a millimetre in rad
    force_noise: float = 0.15  # of the force sensor, N; a tenth of it in N·m for torque
    phantom: PhantomConfig = field(default_factory=PhantomConfig)
    robot: str = FREE  # or an arm, within whose limits every sweep stays

    def told(self) -> dict[str, Any]:
        """Return the settings for a recipe; one that came later is left out where it is unused."""
        told = dataclasses.asdict(self)
        return told if self.robot != FREE else {k: v for k, v in told.items() if k != "robot"}


class Felt(Protocol):
    """Whatever says what is felt at a pose."""

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force, N, and torque, N·m, in the probe's axes."""
        ...


class Limits(NamedTuple):
    """What holds a path back."""

    space: Workspace
    floor: float  # height of the tip at which the robot's force limit stops it, m


class PlannedSweep(NamedTuple):
    """One trajectory of T poses."""

    pose: Pose  # where the probe truly is
    velocity: Tensor  # (T, 6) true velocity, m/s and rad/s, base frame
    control: Tensor  # (T, 6) commanded velocity, without the tremor
    times: Tensor  # (T,) float64 seconds


_AGAIN = 0xA26
"""Keeps sweeps that are drawn in place of another apart from all else that its seed draws."""
_REMEDIES = {"time": "raise data.phantom.shortest", "calm": "lower data.phantom.tremor"}
DWELL = 0.53  # share of a trajectory's frames in which the view is held


def plan_lengths(config: AcquisitionConfig) -> list[int]:
    """Draw trajectory lengths that add up to `frames`."""
    span = config.longest - config.shortest + 1
    count = max(1, round(config.frames / ((config.longest + config.shortest) / 2)))
    drawn = uniform(sample_seeds(config.seed, 1), count, stream=1)[0]
    lengths = (config.shortest + (drawn * span).long()).tolist()
    # Spread what is missing or too much evenly, so that no trajectory becomes odd.
    excess = config.frames - sum(lengths)
    for i in range(count):
        share = (excess * (i + 1)) // count - (excess * i) // count
        lengths[i] = max(2, lengths[i] + share)
    lengths[-1] += config.frames - sum(lengths)
    return lengths


def plan_targets(count: int, config: AcquisitionConfig) -> list[str]:
    """Return the target of each trajectory: views in turn, random scans evenly between them."""
    views = itertools.cycle(anatomy_views(config.phantom.anatomy))
    scans = [math.floor(i * config.random_share + 0.5) for i in range(count + 1)]
    return [RANDOM if stop > start else next(views) for start, stop in itertools.pairwise(scans)]


def make_sweep(
    phantom: Phantom,
    config: AcquisitionConfig,
    target: str,
    session: int,
    length: int,
    seed: Tensor,
) -> PlannedSweep:
    """Draw one sweep of `length` frames from a (1,) seed.

    Where an arm cannot follow it, others are drawn.

    Raises:
        RacinesError: none of them either.
    """
    limits = limits_of(phantom.workspace, phantom.surface_height, phantom.config)

    def drawn(attempt: int) -> PlannedSweep:
        draw = again(seed, attempt)
        if target == RANDOM:
            points, shares = random_points(phantom.wander, phantom.surface_height, draw)
        else:
            points, shares = _view_points(phantom, target, draw)
        return follow(points, shares, limits, config, session, length, draw)

    return first_followed(drawn, "data.phantom.robot", _REMEDIES)


def again(seed: Tensor, attempt: int) -> "Draw":
    """Return the draws of an attempt at a sweep; the first is what is drawn for a free probe."""
    return Draw(derive(seed, _AGAIN, attempt) if attempt else seed)


def follow(
    points: Tensor,
    shares: Tensor,
    limits: Limits,
    config: AcquisitionConfig,
    session: int,
    length: int,
    draw: "Draw",
) -> PlannedSweep:
    """Move a hand through (P, 6) way-points in `length` frames; (P - 1,) shares of time a move.

    Raises:
        CannotFollow: an arm is to follow, and cannot.
    """
    points[:, 2] -= 0.0008 * (session % 3 - 1)  # sessions press harder or softer
    hurry = None
    if config.robot != FREE:

        def poses(shares: Tensor) -> Pose:
            return pose_at(_limit(_minimum_jerk(points, shares, length), limits))

        hurry = hurry_of(config.robot, config.rate)
        shares = paced(shares, hurry, length, poses)
    smooth = _limit(_minimum_jerk(points, shares, length), limits)
    shaky = smooth + _tremor(length, config, draw) * (0.8 + 0.25 * (session % 3))
    shaky = _limit(shaky, limits)
    if hurry is not None:
        check_followed(pose_at(shaky), hurry)
    times = torch.arange(length, dtype=torch.float64) / config.rate
    return PlannedSweep(pose_at(shaky), _velocity(shaky, config), _velocity(smooth, config), times)


class Draw:
    """A stream of draws from one seed."""

    def __init__(self, seed: Tensor):
        self._seed, self._streams = seed, itertools.count(101)

    def uniform(self, *shape: int) -> Tensor:
        """Draw numbers in [0, 1)."""
        return uniform(self._seed, math.prod(shape), next(self._streams)).view(shape)

    def normal(self, *shape: int) -> Tensor:
        """Draw standard normal numbers."""
        return normal(self._seed, math.prod(shape), next(self._streams)).view(shape)


def coordinates(pose: Pose) -> Tensor:
    """Return (B, 6): position, and Euler angles with rotation_x measured from straight down."""
    angles = matrix_to_euler(pose.rotation)
    lean = torch.remainder(angles[:, :1], 2 * math.pi) - math.pi
    return torch.cat([pose.position, lean, angles[:, 1:]], -1)


def pose_at(path: Tensor) -> Pose:
    """Return the poses of (T, 6) coordinates."""
    angles = path[:, 3:] + path.new_tensor([math.pi, 0.0, 0.0])
    return Pose(path[:, :3].contiguous(), euler_to_matrix(angles))


_SPREAD = torch.tensor([1.0, 1.0, 0.15, 1.0, 1.0, 1.0])
_DEGREES_A_MILLIMETRE = math.radians(1.0) / 0.001


def around(point: Tensor, millimetres: float, draw: Draw, count: int = 1) -> Tensor:
    """Scatter points by some millimetres in position and as many degrees in angle."""
    scale = _SPREAD * millimetres * 1e-3
    scale[3:] *= _DEGREES_A_MILLIMETRE
    return point + draw.normal(count, 6) * scale


def _view_points(phantom: Phantom, view: str, draw: Draw) -> tuple[Tensor, Tensor]:
    """Return way-points (P, 6) of a sweep to a view, and the share of time of each move."""
    target = coordinates(phantom.target(view))[0].cpu()
    home = target.new_tensor(phantom.home)
    home[2] = target[2]
    start = torch.lerp(target, home, 0.25 + 0.6 * draw.uniform(1)[0])
    return sweep_points(around(start, 7.0, draw), start, target, phantom.surface_height, draw)


def sweep_points(
    touch: Tensor, start: Tensor, target: Tensor, surface: float, draw: Draw
) -> tuple[Tensor, Tensor]:
    """Return way-points (P, 6) from a (1, 6) touch near a (6,) start to a (6,) target, and shares.

    The target is overshot as seen from the start, corrected, held and left; `surface` is the height
    of what is touched, m.
    """
    above = touch.clone()
    above[:, 2] = surface + 0.008 + 0.061 * draw.uniform(1)
    overshoot = around(target + 0.18 * (target - start), 5.0, draw)
    holds = around(target, 1.7, draw, 5)
    holds[0] = around(target, 3.5, draw)[0]
    leave = around(holds[-1:], 8.0, draw)
    leave[:, 2] = surface + 0.012 * draw.uniform(1)
    points = torch.cat([above, touch, overshoot, holds, leave])
    shares = torch.tensor([0.10, 0.13, 0.08, *[DWELL / 5] * 4, DWELL / 5, 0.07])
    return points, shares[: len(points) - 1] * (0.7 + 0.6 * draw.uniform(len(points) - 1))


def random_points(
    wander: tuple[float, float, float], surface: float, draw: Draw
) -> tuple[Tensor, Tensor]:
    """Return way-points of a scan that wanders about a place, x and y, m, and a turn, rad."""
    count = 7
    spread = torch.tensor([0.036, 0.016, 0.0022, 0.26, 0.20, 0.70])
    x, y, turn = wander
    centre = torch.tensor([x, y, surface - 0.006, 0.0, 0.0, turn])
    points = centre + draw.normal(count, 6) * spread
    points[0, 2] = points[-1, 2] = surface + 0.006
    return points, 0.5 + draw.uniform(count - 1)


def _minimum_jerk(points: Tensor, shares: Tensor, length: int) -> Tensor:
    """Join (P, 6) way-points by minimum-jerk moves into a (length, 6) path."""
    ends = torch.cat([shares.new_zeros(1), shares.cumsum(0) / shares.sum()])
    time = torch.linspace(0.0, 1.0, length)
    leg = torch.searchsorted(ends, time, right=True).sub(1).clamp(0, len(shares) - 1)
    phase = ((time - ends[leg]) / (ends[leg + 1] - ends[leg])).clamp(0.0, 1.0)
    blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return torch.lerp(points[leg], points[leg + 1], blend.unsqueeze(-1))


def _tremor(length: int, config: AcquisitionConfig, draw: Draw) -> Tensor:
    """Draw (length, 6) of smooth noise: white noise averaged over a third of a second."""
    width = max(1, round(config.rate / 3))
    white = draw.normal(length + width - 1, 6)
    smooth = white.unfold(0, width, 1).mean(-1) * math.sqrt(width)
    scale = torch.full((6,), config.tremor)
    scale[3:] *= _DEGREES_A_MILLIMETRE
    scale[2] *= 0.4
    return smooth * scale


def limits_of(space: Workspace, surface: float, config: PhantomConfig) -> Limits:
    """Return the limits of a workspace over a surface at a height, m."""
    return Limits(space, deepest(config.workspace.press, surface, config.contact))


def _limit(path: Tensor, limits: Limits) -> Tensor:
    """Hold a path within the workspace and the force limit, as the robot's safety does."""
    space = limits.space
    low = space.position_min.cpu().clone()
    low[2] = max(float(low[2]), limits.floor)
    position = torch.clamp(path[:, :3], low, space.position_max.cpu())
    lean = path[:, 3:5]
    size = lean.norm(dim=-1, keepdim=True)
    lean = lean * (0.98 * space.tilt_max / size.clamp_min(1e-6)).clamp_max(1.0)
    yaw = path[:, 5:].clamp(-0.98 * space.yaw_max, 0.98 * space.yaw_max)
    return torch.cat([position, lean, yaw], -1)


def _velocity(path: Tensor, config: AcquisitionConfig) -> Tensor:
    """Differentiate a (T, 6) path; angular part as the base-frame rotation rate."""
    rate = torch.gradient(path, dim=0)[0] * config.rate
    rotation = pose_at(path).rotation
    step = torch.gradient(rotation, dim=0)[0] * config.rate
    skew = (step.unsqueeze(-2) * rotation.unsqueeze(-3)).sum(-1)  # dR Rᵀ
    spin = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], -1)
    return torch.cat([rate[:, :3], spin], -1)


def record(phantom: Felt, config: AcquisitionConfig, sweep: PlannedSweep, seed: Tensor) -> Tensor:
    """Return (T, 12) measured parameters: the true ones with the sensors' noise."""
    noise = normal(derive(seed, 7), len(sweep.times) * 12, 0).view(-1, 12).to(sweep.control)
    wrench = phantom.wrench(sweep.pose, sweep.velocity)
    force = wrench[:, :3] + config.force_noise * noise[:, :3]
    torque = wrench[:, 3:] + 0.1 * config.force_noise * noise[:, 3:6]
    position = sweep.pose.position + config.pose_noise * noise[:, 6:9]
    tilt = 100.0 * config.pose_noise * 0.01 * noise[:, 9:]
    angles = matrix_to_euler(sweep.pose.rotation) + tilt
    angles = torch.remainder(angles + math.pi, 2 * math.pi) - math.pi
    return torch.cat([force, torque, position, angles], -1)
