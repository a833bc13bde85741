"""Recordings in the place of a phantom: their own labels, box and poses are all that is known."""

import math

import pyarrow.parquet as pq
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose, pose_to_parameters
from racines_data.randomness import uniform
from racines_data.store.frames import FrameStore
from racines_data.world import Truth, Workspace, World
from racines_envs.worlds.replay_images import Replay

_STREAM = 102
_SLACK = 1e-4  # rad, added to tilt and yaw: a recorded pose lies within its own limits


class RecordedWorld(World):
    """What an environment asks a phantom, answered by the frames of a `Replay`.

    The truth at a pose is the label and the grade of the nearest recorded frame, `Random` and 0 out
    of support. Labels and grades are the dataset's own, or a grader's where it has none; frames
    with neither are refused.
    """

    def __init__(self, replay: Replay, device: torch.device | str = "cpu") -> None:
        store = replay.store
        self.replay, self.device = replay, torch.device(device)
        self.labels, self.views = store.labels, store.labels[:-1]
        views, grades, self.truth_source = _labels(store, replay.split)
        self._views, self._grades = views.to(device), grades.to(device)
        self._pose = parameters_to_pose(replay.parameters)
        position, rotation = self._pose
        tilt = torch.acos((-rotation[:, 2, 2]).clamp(-1.0, 1.0)).max()
        yaw = torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0]).abs().max()
        lean, turn = float(tilt) + _SLACK, min(float(yaw) + _SLACK, math.pi)
        self.workspace = Workspace(position.amin(0), position.amax(0), lean, turn)

    def target(self, view: str) -> Pose:
        """Return the pose of the best-graded frame that shows a view, a batch of one.

        Of equally good ones, the one nearest to where they all are on average.
        """
        if view not in self.views:
            raise RacinesError(f"unknown view {view!r}: choose one of {', '.join(self.views)}")
        shows = self._views == self.views.index(view)
        if not bool(shows.any()):
            raise RacinesError(
                f"{self.replay.store.root}: no frame of split {self.replay.split!r} shows {view}: "
                "choose another view, or more data"
            )
        grade = torch.where(shows, self._grades, -1.0)
        best = (grade >= grade.max() - 1e-6).nonzero().squeeze(1)
        position, rotation = (x[best] for x in self._pose)
        away = (position - position.mean(0)).norm(dim=-1)
        turned = (rotation - rotation.mean(0)).flatten(1).norm(dim=-1)
        row = best[(away / 0.003 + turned / 0.06).argmin()]
        return Pose(*(x[row][None] for x in self._pose))

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return the (B, 6) recorded wrench nearest to poses, N and N·m."""
        return self.replay.wrench(pose)

    def judge(self, pose: Pose) -> Truth:
        """Return what the nearest recorded frames were labelled; see the class."""
        index, distance = self.replay.index.nearest_to(pose)
        label = torch.where(distance > self.replay.threshold, len(self.views), self._views[index])
        every = torch.arange(len(self.views), device=label.device)
        shows = (label[:, None] == every).float()
        grade = self._grades[index] * shows.sum(1)
        ones = torch.ones_like(grade)
        return Truth(label, grade, shows, shows * grade[:, None], ones, ones[:, None][:, :0])

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return the (B, 128, 128) images recorded nearest to poses."""
        return self.replay.generate(pose_to_parameters(pose), seeds)

    def own_nearest(self, pose: Pose, label: int, units: tuple[float, float]) -> Pose:
        """Return the nearest recorded poses labelled with a view, near in unit steps."""
        rows = (self._views == label).nonzero().squeeze(1)
        shown = Pose(*(x[rows] for x in self._pose))
        found = []
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

    def own_starts(
        self, label: int, target: Pose, seeds: Tensor, distance: tuple[float, float],
        angle: tuple[float, float],
    ) -> Pose:  # fmt: skip
        """Return (N,) recorded poses, each drawn by its own seed from those that may be starts.

        Those are the frames that do not show the view and lie as far from the nominal pose as asked
        for, along the block's top and in angle; where there is none, all that do not show the view.
        """
        position, rotation = self._pose
        other = self._views != label
        across = (position - target.position)[:, :2].norm(dim=-1)
        turned = geodesic(rotation, target.rotation)
        fits = other & (across >= distance[0]) & (across <= distance[1])
        fits &= (turned >= angle[0]) & (turned <= angle[1])
        rows = (fits if bool(fits.any()) else other).nonzero().squeeze(1)
        if not len(rows):
            raise RacinesError(f"every recorded frame shows {self.views[label]}: there is no start")
        place = (uniform(seeds, 1, _STREAM).squeeze(1) * len(rows)).long().clamp_max(len(rows) - 1)
        return Pose(*(x[rows[place]] for x in self._pose))


def _labels(store: FrameStore, split: str) -> tuple[Tensor, Tensor, str]:
    """Return the (M,) labels and grades of a split, and whose they are: `dataset` or `grader`."""
    rows = slice(*store.bounds(split))
    views, grades = store.views[rows], store.grades[rows]
    if bool((views >= 0).all()) and bool(torch.isfinite(grades).all()):
        return views, grades, "dataset"
    paths = [store.root / name for name in store.manifest["configs"]["frames"].get(split, [])]
    names = ["view_predicted", "grade_predicted"]
    columns = pq.read_table(paths, columns=names) if paths else None
    if columns is None or any(columns[name].null_count for name in names):
        raise RacinesError(
            f"{store.root}: its frames have no view and grade to serve as truth: let a grader "
            f"annotate them: racines data annotate {store.root}"
        )
    predicted, graded = (torch.tensor(columns[name].to_numpy()) for name in names)
    return predicted.long(), graded.float(), "grader"
