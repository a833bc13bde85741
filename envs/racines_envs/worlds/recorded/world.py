"""Recorded frames as a world: all that an environment asks, answered by the nearest of them.

    pose (and phase)  ->  nearest recorded frame  ->  image, label and grade
    pose              ->  within reach of any?     ->  a step is taken, or refused
    pose              ->  distance from the goal   ->  errors; by pose also the hit

Nothing is drawn, and nothing is known of where nobody recorded.
"""

import copy
import math
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    geodesic,
    matmul3,
    pose_keys,
    rotation_vector,
)
from racines_data.randomness import uniform
from racines_data.views import RANDOM
from racines_data.world import Truth, Workspace, World
from racines_envs.task.rewards import RewardConfig
from racines_envs.task.tasks import Task
from racines_envs.worlds.recorded.frames import FULL_GRADE, Frames
from racines_envs.worlds.recorded.index import Nearest, phase_keys
from racines_envs.worlds.recorded.paths import Ways, usual_reach
from racines_envs.worlds.recorded.settings import LABEL, MASK, ReplayConfig

VERSION = 1
"""Of the rules by which a replay answers; part of its recipe."""
GOAL = "Goal"
"""What the only view is called where a frame is looked for and not a view."""
ANATOMY = "recorded"
MILLI = 1e-3
FORCE_LIMIT = 20.0
"""Greatest normal force, N, where no recorded frame was pressed harder."""
EDGE, LOOK = 10.0, 2.5
"""How dear a metre of missing margin about a hit is, and unit steps that a way is looked ahead."""
_STREAM = 103


class Aim(NamedTuple):
    """What episodes look for."""

    view: str
    """Name of the view, or `GOAL`."""
    label: int
    """Its label among the dataset's, -1 where the goal bears none."""
    frame: int
    """Place of the frame whose pose is the nominal one."""
    by: str
    """`label` or `pose`."""


class RecordedPlaces(Workspace):
    """Where the probe may be: within reach of a recorded pose."""

    def __init__(self, pose: Pose, near: Nearest, turn: float, reach: float) -> None:
        """Take (M,) recorded poses, what finds them, and a turn's weight and the reach, m."""
        low, high = pose.position.amin(0) - reach, pose.position.amax(0) + reach
        super().__init__(low, high, math.pi, math.pi)
        for name, value in (("near", near), ("turn", turn), ("reach", reach)):
            object.__setattr__(self, name, value)

    near: Nearest
    turn: float
    reach: float

    def contains(self, pose: Pose) -> Tensor:
        """Return (B,) bool."""
        return self.near(pose_keys(pose, self.turn))[1] <= self.reach


class Recordings(World):
    """The frames of a dataset in the place of a phantom; lengths in m, or thousands of pixels.

    By label, what is true at a pose is label and grade of the nearest recorded frame. By pose, the
    goal is shown within `within` and `within_degrees` of it, and its grade falls evenly from 10 at
    the goal to 5 at the farther of the two bounds.
    """

    def __init__(self, frames: Frames, aim: Aim, config: ReplayConfig) -> None:
        """Index the frames; see `open_recordings`, which finds them and what is aimed at."""
        self.frames, self.aim, self.settings = frames, aim, config
        known = frames.store.labels
        self.labels = known if aim.by == LABEL else (aim.view, RANDOM)
        self.views = self.labels[:-1]
        self.masks = config.beyond == MASK
        """Whether steps that would be refused are told beforehand."""
        self._turn = config.turn * MILLI
        keys = pose_keys(frames.pose, self._turn)
        self._near_pose = near = Nearest(keys, keys.device)
        radians = math.radians(config.step_degrees)
        self._step = step = max(config.step * MILLI, 2.0 * self._turn * math.sin(radians / 2.0))
        self.reach = config.reach * MILLI or usual_reach(keys, frames.trajectory(), step)
        """Farthest from a recorded pose that the probe may be, m."""
        if self.reach < step:
            raise RacinesError(
                f"replay.reach is {config.reach:g}: less than a unit step, which weighs "
                f"{step / MILLI:.2f} {frames.unit}: none could be taken"
            )
        # Between frames so near, steps that miss the straight way by one stay within reach; and a
        # step leads from a frame to any that is nearer than that.
        self._link = max(2.0 * (self.reach - step), step)
        self.workspace = RecordedPlaces(frames.pose, near, self._turn, self.reach)
        self._near = near if frames.phase is None else self._with_phase(keys)
        self._phase: Tensor | None = None
        self._images = self._held_images()

    def _with_phase(self, keys: Tensor) -> Nearest:
        assert self.frames.phase is not None
        phase = phase_keys(self.frames.phase, self.settings.phase * MILLI)
        return Nearest(torch.cat([keys, phase], -1), keys.device)

    def _held_images(self) -> Tensor | None:
        """Return the frames' images on an accelerator; on the CPU they stay in the file."""
        if self.frames.rows.device.type == "cpu":
            return None
        frames = self.frames
        return frames.store.images[frames.rows.cpu()].to(frames.rows.device)

    @property
    def unit(self) -> str:
        """A thousandth of a length here: `mm` or `px`."""
        return self.frames.unit

    @cached_property
    def ways(self) -> Ways:
        """The ways along recorded poses to the frames that hit."""
        keys = self._near_pose.keys
        return Ways(keys, self.frames.trajectory(), self._link, self._costs(keys))

    def _costs(self, keys: Tensor) -> Tensor:
        """Return what it costs to end a way at each frame, (M,) m; infinite where none ends.

        By pose it ends at the goal. By label at frames that hit; at such as lie next to one that
        does not it ends dearly, for steps miss a pose by half of one along each axis.
        """
        cost = torch.full((len(keys),), torch.inf, device=keys.device)
        if self.aim.by != LABEL:
            cost[self.aim.frame] = 0.0
            return cost
        hits = self.shows & (self.frames.grades >= RewardConfig().grade)
        hits = hits if bool(hits.any()) else self.shows
        if bool(hits.all()):
            return cost.zero_()
        depth = Nearest(keys[~hits], keys.device)(keys[hits])[1]
        cost[hits] = EDGE * (self._step - depth).clamp_min(0.0)
        return cost

    def waypoint(self, pose: Pose) -> Pose:
        """Return (B,) recorded poses to go to next, on the shortest ways to a hit."""
        keys = pose_keys(pose, self._turn)
        return self._taken(self.ways.ahead(keys, self._look, self._step))

    def steps_left(self, pose: Pose) -> Tensor:
        """Return the (B,) lengths of the shortest ways to a hit, in longest unit steps.

        Where none is known, those that the episode may have.
        """
        left = self.ways.lengths(pose_keys(pose, self._turn), self._look) / self._step
        return left.clamp_max(self.settings.max_steps)

    @property
    def _look(self) -> float:
        return max(LOOK * self._step, self._link)

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What decides where actions lead: dataset, settings, goal; JSON-able."""
        manifest, frames, aim = self.frames.store.manifest, self.frames, self.aim
        told = {
            "version": VERSION,
            "world": ANATOMY,
            "dataset": {
                "source": manifest["source"],
                "version": manifest["version"],
                "digest": frames.store.digest,
            },
            "settings": vars(self.settings) | {"reach": self.reach / MILLI},
            "aim": {"view": aim.view, "by": aim.by, "frame": frames.name(aim.frame)},
            "labels": frames.labelled_by,
            "frames": len(frames),
            "starts": len(self.start_frames),
            "starts_cut_off": self._cut_off,
            "phases": frames.phase is not None,
            "unit": frames.unit,
        }
        return told | {"recipe_digest": recipe_digest(told)}

    def task(self, view: str = "") -> Task:
        """Return the task of a view: that which was opened."""
        if view not in ("", self.aim.view):
            raise RacinesError(
                f"this replay looks for {self.aim.view}, not {view}: open another for that view"
            )
        config, pressed = self.settings, -self.frames.wrench[:, 2]
        return Task(
            self.aim.view,
            anatomy=ANATOMY,
            views=self.views,
            start_distance=(config.start[0] * MILLI, config.start[1] * MILLI),
            start_height=(0.0, 0.0),
            start_angle=(
                math.radians(config.start_degrees[0]),
                math.radians(config.start_degrees[1]),
            ),
            step_translation=config.step * MILLI,
            step_rotation=math.radians(config.step_degrees),
            force_limit=max(FORCE_LIMIT, float(pressed.max())),
            max_steps=config.max_steps,
        )

    def target(self, view: str) -> Pose:
        """Return the pose of the goal's frame, a batch of one."""
        if view != self.aim.view:
            raise RacinesError(f"unknown view {view!r}: this replay looks for {self.aim.view}")
        return self._taken(torch.tensor([self.aim.frame]))

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return the (B, 6) wrench recorded nearest to poses, N and N·m; 0 where not measured."""
        return self.frames.wrench[self._near_pose(pose_keys(pose, self._turn))[0]]

    def scene(self, case: Tensor, time: Tensor) -> "Recordings":
        """Return the recordings at (B,) seconds of a beat each; the same where there is none."""
        if self.frames.phase is None:
            return self
        beat = self.settings.beat_seconds
        other = copy.copy(self)
        other._phase = (time / beat).remainder(1.0) if beat else torch.zeros_like(time)
        return other

    def at(self, rows: Tensor) -> "Recordings":
        """Return the recordings as (M,) of the rows have them."""
        if self._phase is None:
            return self
        other = copy.copy(self)
        other._phase = self._phase[rows]
        return other

    def nearest(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return the (B,) places of the frames nearest to poses, and their (B,) distance, m.

        Nearest in pose and phase, where the rows have one; the distance is that of the poses.
        """
        keys = pose_keys(pose, self._turn)
        if self._phase is None:
            return self._near_pose(keys)
        phase = phase_keys(self._phase, self.settings.phase * MILLI)
        index, _ = self._near(torch.cat([keys, phase.to(keys.device)], -1))
        return index, (keys - self._near_pose.keys[index]).norm(dim=-1)

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return the (B, 128, 128) images recorded nearest to poses; the seeds draw nothing."""
        index = self.nearest(pose)[0]
        if self._images is not None:
            return self._images[index]
        return self.frames.store.images[self.frames.rows[index]]

    def judge(self, pose: Pose) -> Truth:
        """Return the truth of (B,) poses; see the class."""
        view, grade = self._by_label(pose) if self.aim.by == LABEL else self._by_pose(pose)
        every = torch.arange(len(self.views), device=view.device)
        shows = (view[:, None] == every).float()
        as_view = shows * grade[:, None]
        ones = torch.ones_like(grade)
        return Truth(view, as_view.sum(1), shows, as_view, ones, ones[:, None][:, :0])

    def _by_label(self, pose: Pose) -> tuple[Tensor, Tensor]:
        index, away = self.nearest(pose)
        beyond = away > self.reach
        view = torch.where(beyond, len(self.views), self.frames.views[index])
        return view, self.frames.grades[index]

    def _by_pose(self, pose: Pose) -> tuple[Tensor, Tensor]:
        shift, turn = self._off(pose)
        off = torch.maximum(shift, turn)
        return (off > 1.0).long(), FULL_GRADE - 5.0 * off

    def _off(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return shift and turn from the goal, (B,), in what is allowed of each."""
        goal, config = self.target(self.aim.view), self.settings
        shift = (pose.position - goal.position).norm(dim=-1) / (config.within * MILLI)
        turn = geodesic(pose.rotation, goal.rotation) / math.radians(config.within_degrees)
        return shift, turn

    def own_nearest(self, pose: Pose, label: int, units: tuple[float, float]) -> Pose:
        """Return the nearest of poses that show the goal: recorded ones by label, any by pose."""
        if self.aim.by != LABEL:
            return self._into_bounds(pose)
        rows = (self.frames.views == label).nonzero().squeeze(1)
        shown, found = self._taken(rows), []
        for position, rotation in zip(*(x.split(64) for x in pose), strict=True):
            steps = (position[:, None] - shown.position).norm(dim=-1) / units[0]
            found.append((steps + geodesic(rotation[:, None], shown.rotation) / units[1]).argmin(1))
        index = torch.cat(found)
        # Where the pose is judged to show the view already, by its nearest frame, it is the answer.
        seen = (self.judge(pose).view == label)[:, None]
        return Pose(
            torch.where(seen, pose.position, shown.position[index]),
            torch.where(seen[..., None], pose.rotation, shown.rotation[index]),
        )

    def _into_bounds(self, pose: Pose) -> Pose:
        """Return poses moved towards the goal, straight, until they are within the bounds."""
        target = self.target(self.aim.view)
        goal = Pose(*(x.expand_as(y) for x, y in zip(target, pose, strict=True)))
        shift, turn = ((1.0 - 1.0 / x).clamp_min(0.0)[:, None] for x in self._off(pose))
        vector = rotation_vector(matmul3(pose.rotation.transpose(-1, -2), goal.rotation))
        turned = matmul3(pose.rotation, axis_angle_to_matrix(vector * turn))
        return Pose(pose.position + shift * (goal.position - pose.position), turned)

    def own_starts(
        self, label: int, target: Pose, seeds: Tensor, distance: tuple[float, float],
        angle: tuple[float, float],
    ) -> Pose:  # fmt: skip
        """Return (N,) recorded poses, each drawn by its own seed from those that may be starts."""
        return self._taken(self.drawn_starts(seeds))

    def drawn_starts(self, seeds: Tensor) -> Tensor:
        """Return the (N,) places of the frames that episodes of (N,) seeds start from."""
        may = self.start_frames
        place = (uniform(seeds, 1, _STREAM).squeeze(1) * len(may)).long().clamp_max(len(may) - 1)
        return may[place]

    def start_units(self, seeds: Tensor) -> Tensor:
        """Return the (N,) trajectories that episodes of (N,) seeds start in: the units."""
        return self.frames.trajectory()[self.drawn_starts(seeds).cpu()]

    @cached_property
    def start_frames(self) -> Tensor:
        """The places of the frames that may be starts.

        Of the split; not showing the goal; as far from it as asked for; and such that a way along
        recorded poses leads to it.

        Raises:
            RacinesError: there is none.
        """
        return self._starts[0]

    @property
    def _cut_off(self) -> int:
        return self._starts[1]

    @cached_property
    def _starts(self) -> tuple[Tensor, int]:
        frames, config, aim = self.frames, self.settings, self.aim
        goal = self.target(aim.view)
        shift = (frames.pose.position - goal.position).norm(dim=-1) / MILLI
        turn = geodesic(frames.pose.rotation, goal.rotation).rad2deg()
        fits = (shift >= config.start[0]) & (shift <= config.start[1])
        fits &= (turn >= config.start_degrees[0]) & (turn <= config.start_degrees[1])
        fits &= frames.starts & ~self.shows
        may = (fits & self.ways.joined).nonzero().squeeze(1)
        if not len(may):
            cut = int(fits.sum())
            reason = (
                f"none of {cut} frames is joined to it by recorded poses: raise replay.reach "
                f"({self.reach / MILLI:.1f} {self.unit})"
                if cut
                else "every frame shows it, or is not as far as replay.start and start_degrees say"
            )
            raise RacinesError(
                f"{frames.store.root}: no frame of split {config.split!r} can be a start for "
                f"{aim.view}: {reason}"
            )
        return may, int(fits.sum()) - len(may)

    @cached_property
    def shows(self) -> Tensor:
        """(M,) bool: the frames that show the goal, of whatever phase."""
        if self.aim.by == LABEL:
            return self.frames.views == self.aim.label
        shift, turn = self._off(self.frames.pose)
        return (shift <= 1.0) & (turn <= 1.0)

    def told(self, pose: Pose) -> dict[str, Tensor]:
        """Return the store's row of each pose's frame, (B,), and its distance, m."""
        index, away = self.nearest(pose)
        return {"frame": self.frames.rows[index], "frame_distance": away}

    def _taken(self, index: Tensor) -> Pose:
        return Pose(*(x[index.to(x.device)] for x in self.frames.pose))
