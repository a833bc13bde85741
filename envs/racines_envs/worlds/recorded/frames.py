"""What a replay holds of a dataset: poses, images, labels and phases of the frames it shows."""

from dataclasses import dataclass
from typing import Any

import pyarrow.parquet as pq
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.manifest import scale_known
from racines_data.store.frames import FrameStore
from racines_envs.worlds.recorded.settings import OWN_SPLIT, ReplayConfig

FULL_GRADE = 10.0
"""Grade of a frame that bears a label and no grade: where none are given the label alone decides.
"""
_CENTRAL = 0.003, 0.06
"""What counts as one step of shift, m, and of turn, in choosing the most central of equal frames.
"""


@dataclass(frozen=True)
class Frames:
    """M recorded frames with poses, on one device; M is 2 or more."""

    store: FrameStore
    rows: Tensor
    """(M,) int64 rows of the store, ascending."""
    pose: Pose
    """(M,) m; thousands of pixels where there is no millimetre scale."""
    wrench: Tensor
    """(M, 6) N and N·m; what was not measured is 0."""
    starts: Tensor
    """(M,) bool: of the split that episodes start from."""
    views: Tensor
    """(M,) int64 labels; what is not known is `Random`."""
    grades: Tensor
    """(M,) float32, 0-10; 0 of `Random`."""
    labelled_by: str
    """Whose views they are: `dataset`, `grader`, or `nobody`."""
    graded: bool
    """Whether grades were given: else every labelled frame has a full one."""
    phase: Tensor | None
    """(M,) float64 cardiac phase in [0, 1), or None."""
    unit: str
    """`mm` or `px`: a thousandth of what positions are given in."""
    left_out: int
    """Frames of the dataset that have no pose."""

    def __len__(self) -> int:
        return len(self.rows)

    def name(self, index: int) -> str:
        """Return a frame's name, `TRAJECTORY:FRAME`."""
        row = int(self.rows[index])
        store = self.store
        return f"{store.trajectories[int(store.trajectory_index[row])]}:{int(store.frame[row])}"

    def find(self, name: str) -> int:
        """Return the place of the frame of a name.

        Raises:
            RacinesError: there is no such frame, or it has no pose or is not among these.
        """
        trajectory, _, number = name.rpartition(":")
        store, rows = self.store, self.rows.cpu()
        if trajectory in store.trajectories and number.isdigit():
            own = store.trajectory_index[rows] == store.trajectories.index(trajectory)
            found = (own & (store.frame[rows] == int(number))).nonzero()
            if len(found):
                return int(found[0])
        raise RacinesError(
            f"{store.root}: no frame {name!r} with a pose among those replayed: give "
            f"TRAJECTORY:FRAME, as {self.name(len(self) // 2)}"
        )

    def trajectory(self) -> Tensor:
        """Return the (M,) places of the frames' trajectories in the store."""
        return self.store.trajectory_index[self.rows.cpu()]


def read_frames(
    store: FrameStore, config: ReplayConfig, device: torch.device | str = "cpu"
) -> Frames:
    """Return the frames that a replay shows.

    Raises:
        RacinesError: no poses, no frame of the split, an unknown session, or one frame alone.
    """
    posed = torch.isfinite(store.parameters[:, 6:]).all(1)
    if not bool(posed.any()):
        raise RacinesError(
            f"{store.root}: frames without poses ({store.manifest['source']}) cannot be replayed: "
            "give a dataset of poses and images"
        )
    start, stop = store.bounds(config.split)
    of_split = torch.zeros_like(posed)
    of_split[start:stop] = True
    kept = posed & _of_session(store, config.session)
    if config.frames == OWN_SPLIT:
        kept &= of_split
    rows = kept.nonzero().squeeze(1)
    where = f" of session {config.session}" if config.session else ""
    if not bool(of_split[rows].any()):
        raise RacinesError(
            f"{store.root}: split {config.split!r} has no frames with poses{where} to start from"
        )
    if len(rows) == 1:
        raise RacinesError(f"{store.root}: one frame{where} alone: there is nowhere to go")
    unit, scale = length_unit(store.manifest)
    parameters = store.parameters[rows]
    pose = parameters_to_pose(parameters)
    views, grades, labelled_by, graded = _labels(store, rows)
    phase = _phase(store, rows)
    return Frames(
        store,
        rows.to(device),
        Pose(pose.position * scale, pose.rotation).to(device),
        torch.nan_to_num(parameters[:, :6]).to(device),
        of_split[rows].to(device),
        views.to(device),
        grades.to(device),
        labelled_by,
        graded,
        None if phase is None else phase.to(device),
        unit,
        int((~posed).sum()),
    )


def length_unit(manifest: dict[str, Any]) -> tuple[str, float]:
    """Return `mm` or `px`, and what makes a dataset's positions into thousands of them."""
    return ("mm", 1.0) if scale_known(manifest) else ("px", 1e-3)


def _of_session(store: FrameStore, session: str) -> Tensor:
    """Return (N,) bool: the frames of a session, all without one."""
    if not session:
        return torch.ones(len(store), dtype=torch.bool)
    if session not in store.sessions:
        known = ", ".join(sorted(set(store.sessions))[:8])
        raise RacinesError(f"{store.root}: no session {session!r}: it has {known}")
    own = torch.tensor([each == session for each in store.sessions])
    return own[store.trajectory_index]


def _phase(store: FrameStore, rows: Tensor) -> Tensor | None:
    """Return the (M,) cardiac phases, if every frame has one and they are not all the same."""
    if store.phases is None:
        return None
    phase = store.phases[rows, 0]
    known = bool(torch.isfinite(phase).all()) and bool((phase != phase[0]).any())
    return phase if known else None


def _labels(store: FrameStore, rows: Tensor) -> tuple[Tensor, Tensor, str, bool]:
    """Return (M,) labels and grades, whose they are, and whether grades were given."""
    views, grades, source = store.views[rows], store.grades[rows], "dataset"
    random = len(store.labels) - 1
    if not bool((views >= 0).any()):
        views, grades = _predicted(store, rows)
        source = "grader"
    if not bool((views >= 0).any()):
        source = "nobody"
    views = torch.where(views < 0, random, views)
    shown = views != random
    graded = bool(torch.isfinite(grades[shown]).all()) and bool(shown.any())
    full = torch.full_like(grades, FULL_GRADE)
    grades = torch.where(shown, grades if graded else full, 0.0)
    return views, grades, source, graded


def _predicted(store: FrameStore, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return what a grader made of (M,) frames, -1 and NaN of none; the files are as the store."""
    names = ["view_predicted", "grade_predicted"]
    configs = store.manifest["configs"]["frames"]
    paths = [store.root / path for split in configs.values() for path in split]
    columns = [pq.read_table(path, columns=names) for path in paths if path.is_file()]
    if sum(map(len, columns)) != len(store):
        return torch.full_like(rows, -1), torch.full((len(rows),), torch.nan)
    views = torch.cat([torch.tensor(c[names[0]].fill_null(-1).to_numpy()) for c in columns])
    grades = torch.cat([torch.tensor(c[names[1]].fill_null(torch.nan).to_numpy()) for c in columns])
    return views.long()[rows], grades.float()[rows]


def best_shown(views: Tensor, grades: Tensor, pose: Pose, label: int) -> int | None:
    """Return the place of a label's best-graded frame, of equals the most central; None of none."""
    shows = views == label
    if not bool(shows.any()):
        return None
    grade = torch.where(shows, grades, -1.0)
    best = (grade >= grade.max() - 1e-6).nonzero().squeeze(1)
    position, rotation = (x[best] for x in pose)
    away = (position - position.mean(0)).norm(dim=-1)
    turned = (rotation - rotation.mean(0)).flatten(1).norm(dim=-1)
    return int(best[(away / _CENTRAL[0] + turned / _CENTRAL[1]).argmin()])
