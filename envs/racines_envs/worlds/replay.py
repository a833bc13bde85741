"""Recordings: the backend `replay`, and a world in the place of a phantom that nobody knows.

Nothing is drawn: what is shown and felt at a pose is that of the nearest recorded frame. Where
nobody has been, it may be far: `out_of_support` says so.
"""

import math

import pyarrow.parquet as pq
import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose, pose_to_parameters
from racines_data.phantom.config import PhantomConfig, phantom_settings
from racines_data.randomness import uniform
from racines_data.store.frames import FrameStore
from racines_data.world import Truth, Workspace, World
from racines_envs.worlds.recorded.frames import best_shown
from racines_envs.worlds.recorded.index import Nearest
from racines_models.generators.nearest_pose import NearestPose

QUANTILE = 0.99
"""Out of support is farther from every recorded frame than 99 % of frames are from the nearest of
another trajectory."""
SAMPLE = 512
"""Poses whose nearest neighbour in another trajectory says how far apart recordings lie."""
_STREAM = 102
_SLACK = 1e-4  # rad, added to tilt and yaw: a recorded pose lies within its own limits


class PoseIndex:
    """M recorded poses that can be searched.

    The distance is that of `racines_models.generators.nearest_pose`, in metres: a shift, and a turn
    at 0.07 m a radian. A pose's answer ignores its batch.
    """

    def __init__(self, parameters: Tensor, device: torch.device | str = "cpu") -> None:
        """Remember the poses of (M, 12) parameters."""
        self._embed = NearestPose().embed
        self._search = Nearest(self._embed(parameters), device)

    def nearest(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Return the (B,) int64 index of the nearest of them and its (B,) distance, m."""
        return self._search(self._embed(parameters))

    def nearest_to(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return the same of (B,) poses."""
        return self.nearest(pose_to_parameters(pose))


def spacing(parameters: Tensor, trajectory: Tensor, quantile: float) -> float:
    """Return how far apart, m, recordings of one place lie: a quantile in 0-1 over some frames.

    Of 512 of (M, 12), evenly spread, the distance to the nearest frame of another of their (M,)
    trajectories: those of its own lie millimetres away and say nothing about where else the probe
    has been. Of a single trajectory, to its nearest other frame. All on the CPU.
    """
    count, sample = len(parameters), min(len(parameters), SAMPLE)
    if count == 1:
        return 0.0
    keys = NearestPose().embed(parameters)
    own = torch.arange(count) if bool((trajectory == trajectory[0]).all()) else trajectory
    found = []
    for rows in (torch.arange(sample) * count // sample).split(64):
        distance = torch.cdist(keys[rows], keys, compute_mode="donot_use_mm_for_euclid_dist")
        distance[own[rows][:, None] == own[None]] = torch.inf
        found.append(distance.amin(1))
    return float(torch.cat(found).quantile(quantile))


class Replay:
    """Shows the recorded frames, with poses, of a dataset's split; an `ImageSource` that feels."""

    def __init__(
        self, store: FrameStore, device: torch.device | str = "cpu", split: str = "train"
    ) -> None:
        self.store, self.split, self.rows = store, split, slice(*store.bounds(split))
        parameters = store.parameters[self.rows]
        if not len(parameters):
            raise RacinesError(f"{store.root}: split {split!r} has no frames to replay")
        if not bool(torch.isfinite(parameters[:, 6:]).all()):
            raise RacinesError(
                f"{store.root}: frames without poses ({store.manifest['source']}) cannot be "
                "replayed: give a dataset of poses and images"
            )
        self.index = PoseIndex(parameters, device)
        self.threshold = spacing(parameters, store.trajectory_index[self.rows], QUANTILE)
        """Distance, m, from which on a pose is out of support."""
        self.parameters = parameters.to(device)
        self.images = store.images[self.rows].to(device)
        # A force that was not measured is none.
        self._wrench = torch.nan_to_num(self.parameters[:, :6])

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return the (B, 128, 128) images recorded nearest to (B, 12) parameters; no seed."""
        return self.images[self.index.nearest(parameters)[0]]

    def wrench(self, pose: Pose) -> Tensor:
        """Return the (B, 6) wrench recorded nearest to poses, N and N·m; 0 where not measured."""
        return self._wrench[self.index.nearest_to(pose)[0]]

    def out_of_support(self, parameters: Tensor) -> Tensor:
        """Return (B,) bool: no frame was recorded near (B, 12) parameters."""
        return self.index.nearest(parameters)[1] > self.threshold


def source_phantom(store: FrameStore) -> PhantomConfig | None:
    """Return the configuration of the phantom that a dataset was acquired from; None if of none."""
    if store.manifest["source"] != "phantom":
        return None
    told = phantom_settings(store.manifest, "frames") or {"phantom": {}}
    return fill(PhantomConfig, told["phantom"], f"{store.root}/manifest.json: phantom")


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
        """Return the pose of a view's best-graded frame, of equals the most central; one row."""
        if view not in self.views:
            raise RacinesError(f"unknown view {view!r}: choose one of {', '.join(self.views)}")
        row = best_shown(self._views, self._grades, self._pose, self.views.index(view))
        if row is None:
            raise RacinesError(
                f"{self.replay.store.root}: no frame of split {self.replay.split!r} shows {view}: "
                "choose another view, or more data"
            )
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
