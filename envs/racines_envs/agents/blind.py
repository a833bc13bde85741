"""Blind floors: agents that never look, and know what train patients have in common.

    constant-pose   goes to the pose that shows the view in most train patients, and declares
    blind-tour      passes through a dozen poses that together show it in most train patients, the
                    nearest next, rests twice at each, and declares at the last, the constant one

What they reach is what can be had without the image. `train` chooses the poses: the nominal poses
of some train patients are tried on all of them, then poses about those that do best.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_json
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise
from racines_data.randomness import normal
from racines_data.views import VIEWS
from racines_envs.agents.planner import cost_to_go
from racines_envs.agents.protocol import SETTINGS
from racines_envs.agents.steering import Steering
from racines_envs.task.actions import IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.names import PATIENTS, TIERS
from racines_envs.task.rewards import RewardConfig, Score, is_hit
from racines_envs.task.tiers import middles
from racines_envs.worlds.ward import Ward, make_ward
from racines_models.weights import save_weights

POSES = "policy.safetensors"
HOME = 60
"""Steps before the last at which a tour goes to its last waypoint, to declare in time."""
TRIED, AROUND, SHIFT, LEAN = 8, 24, 0.008, 0.12
"""The best poses, how many about each are tried as well, and their spread, m and rad."""
REST = 2
"""Idle steps at a waypoint: with the arrival enough to have reached a view, too few to declare."""


@dataclass(frozen=True)
class BlindConfig:
    """From whom the poses are chosen."""

    tier: str = PATIENTS
    """`patients` or `beating`."""
    patients: int = 120
    """Train patients, whose nominal poses are tried on each other."""
    waypoints: int = 12
    """Poses of a tour, the last included."""
    device: str = "cpu"


class BlindAgent:
    """Goes through known poses of the view and declares at the last; a subclass says how many."""

    name: ClassVar[str]
    Config: ClassVar[type] = BlindConfig
    observation: str = "params"
    sees: ClassVar[str] = "nothing"
    tiers: ClassVar[tuple[str, ...]] = TIERS[1:]
    trained: ClassVar[bool] = False
    """The choice draws nothing by chance."""
    most: ClassVar[int]
    """Waypoints that are used, from the last one back."""

    def __init__(self, poses: Pose) -> None:
        """Take (V, W) poses of the views, in the order of a tour, the best last."""
        self._poses = Pose(*(part[:, -self.most :] for part in poses))

    def attach(self, core: ScanCore) -> None:
        """Take the steps and the workspace of an environment, and learn which view is asked for."""
        if core.task.tier not in self.tiers:
            raise RacinesError(f"{self.name} knows patients, not the one heart: --tier patients")
        self._steering, count = Steering(core), core.num_envs
        self._label = None if core.task.any_view else core.task.target
        self._task, self._left = core.task, torch.zeros(0)
        self._rests = torch.zeros(count, dtype=torch.int64, device=core.device)
        self._steps = torch.zeros_like(self._rests)
        self._at = torch.full((count,), -1, dtype=torch.int64, device=core.device)

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Go on to the waypoint under way, or rest there; (N,) actions."""
        pose = self._steering.pose(observation)
        goals = self._goals(observation, len(seeds))
        fresh = ~self._steering.goes_on()
        self._begin(fresh, pose, goals)
        late = (self._steps >= self._task.max_steps - HOME) & self._left[:, :-1].any(1)
        self._left[:, :-1] &= ~late[:, None]
        self._next(late, pose, goals)
        self._steps = self._steps + 1
        each = torch.arange(len(seeds), device=pose.position.device)
        goal = Pose(*(part[each, self._at] for part in goals))
        action = self._steering.towards(pose, goal)
        there, last = action == IDLE, ~self._left.any(1)
        self._rests = torch.where(there, self._rests + 1, 0)
        leave = there & ~last & (self._rests > REST)
        if bool(leave.any()):
            self._next(leave, pose, goals)
            goal = Pose(*(part[each, self._at] for part in goals))
            action = torch.where(leave, self._steering.towards(pose, goal), action)
            action = self._steering.take(torch.where(~leave & there, IDLE, action))
        return action

    def _goals(self, observation: dict[str, Tensor], count: int) -> Pose:
        """Return the (N, W) waypoints of each row's view."""
        if self._label is None:
            label = observation["goal"].argmax(-1)
        else:
            label = torch.full((count,), self._label)
        return Pose(*(part.to(label.device)[label] for part in self._poses))

    def _begin(self, fresh: Tensor, pose: Pose, goals: Pose) -> None:
        """Start the tours of rows whose episode is new."""
        count, most = goals.position.shape[:2]
        left = torch.ones((count, most), dtype=torch.bool, device=fresh.device)
        if len(self._left):
            left = torch.where(fresh[:, None], left, self._left)
        self._left, self._steps = left, torch.where(fresh, 0, self._steps)
        self._next(fresh, pose, goals)

    def _next(self, rows: Tensor, pose: Pose, goals: Pose) -> None:
        """Send rows to the nearest waypoint that is left; the last one comes last."""
        count, most = goals.position.shape[:2]
        each = Pose(*(part.repeat_interleave(most, 0) for part in pose))
        flat = Pose(*(part.flatten(0, 1) for part in goals))
        cost = cost_to_go(each, flat, self._task).view(count, most)
        open_ = self._left.clone()
        open_[:, -1] &= ~self._left[:, :-1].any(1)
        nearest = torch.where(open_, cost, torch.inf).argmin(1)
        self._at = torch.where(rows, nearest, self._at)
        gone = torch.nn.functional.one_hot(nearest, most).bool() & rows[:, None]
        self._left = self._left & ~gone
        self._rests = torch.where(rows, 0, self._rests)

    @classmethod
    def train(cls, config: BlindConfig, run_dir: Path, **where: Any) -> Self:
        """Choose the poses of each view on train patients."""
        run_dir = Path(run_dir)
        chosen = [choose_poses(config, label) for label in range(len(VIEWS))]
        poses = Pose(*(torch.stack(parts) for parts in zip(*(p for p, _ in chosen), strict=True)))
        columns = {"position": poses.position, "rotation": poses.rotation}
        save_weights(run_dir / POSES, columns)
        shares = {view: told for view, (_, told) in zip(VIEWS, chosen, strict=True)}
        write_json(run_dir / "metrics.json", {"train_patients": config.patients, "views": shares})
        told = {"agent": cls.name, "config": {"tier": config.tier, "patients": config.patients}}
        write_json(run_dir / SETTINGS, told)
        return cls.load(run_dir)

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read the poses that `train` chose."""
        path = Path(run_dir) / POSES
        if not path.is_file():
            raise RacinesError(f"{run_dir}: no poses: run `racines train agent {cls.name}`")
        found = read_tensors(path, ("position", "rotation"), "train it again")
        return cls(Pose(found["position"].to(device), found["rotation"].to(device)))


class ConstantPoseAgent(BlindAgent):
    """Goes to one pose, whoever lies there."""

    name: ClassVar[str] = "constant-pose"
    most: ClassVar[int] = 1


class BlindTourAgent(BlindAgent):
    """Goes through a dozen, the nearest next."""

    name: ClassVar[str] = "blind-tour"
    most: ClassVar[int] = 1_000


def choose_poses(config: BlindConfig, label: int) -> tuple[Pose, dict[str, float]]:
    """Return (W,) poses for a view, the best constant one last, and what they show in train."""
    poses, shows = coverage(config, label)
    best = int(shows.float().mean(0).argmax())
    order, found = [best], shows[:, best].clone()
    for _ in range(config.waypoints - 1):
        gain = (shows & ~found[:, None]).sum(0)
        order.append(int(gain.argmax()))
        found |= shows[:, order[-1]]
    share = {"constant": float(shows[:, best].float().mean()), "tour": float(found.float().mean())}
    rows = torch.tensor(order[::-1])
    return Pose(*(part[rows] for part in poses)), share


def coverage(config: BlindConfig, label: int) -> tuple[Pose, Tensor]:
    """Return (W,) poses, and (K, W) bool: to which train patients they show the view."""
    # No image is drawn, so no voxels are ever held.
    ward = make_ward(config.tier, "train", config.patients, config.device, memory=None)
    every = torch.arange(config.patients, device=ward.pool.device)
    own = Pose(*(part[:, label] for part in ward.pool.targets(every)))
    poses = _joined(own, middles(torch.tensor([label], device=every.device)))
    shows = _shown(ward, poses, label)
    best = shows.sum(0).topk(min(TRIED, len(poses.position))).indices
    more = _about(Pose(*(part[best] for part in poses)))
    inside = ward.workspace.contains(more)
    more = Pose(*(part[inside] for part in more))
    return _joined(poses, more), torch.cat([shows, _shown(ward, more, label)], 1)


def _joined(*poses: Pose) -> Pose:
    return Pose(*(torch.cat(parts) for parts in zip(*poses, strict=True)))


def _about(poses: Pose) -> Pose:
    """Return `AROUND` poses about each of some, always the same."""
    each = Pose(*(part.repeat_interleave(AROUND, 0) for part in poses))
    count, device = len(each.position), each.position.device
    move = normal(torch.arange(count, device=device), 6, 71)
    level = torch.tensor([SHIFT, SHIFT, 0.0], device=device)
    turned = matmul3(each.rotation, axis_angle_to_matrix(move[:, 3:] * LEAN))
    return Pose(each.position + move[:, :3] * level, orthonormalise(turned))


def _shown(ward: Ward, poses: Pose, label: int) -> Tensor:
    """Return (K, W) bool: whether each patient's view is shown at each pose."""
    count, device = len(poses.position), poses.position.device
    rows: list[Tensor] = []
    for patient in range(len(ward.pool)):
        case = torch.full((count,), patient, device=device)
        scene = ward.scene(case, torch.zeros(count, dtype=torch.float64, device=device))
        truth = scene.judge(poses)
        score = Score(truth.membership[:, label], truth.view_grade[:, label], truth.clarity)
        rows.append(is_hit(score, RewardConfig()))
    return torch.stack(rows)
