"""The published RACINES recordings, as people download them; see `release_tree` for the layout.

A folder is a session and an image folder a trajectory. Its view is the sweep's target: what each
frame shows is not in the files, nor is a grade, so `view` and `grade` stay null.

`plan` reads every file once: it checks the PNGs without decoding them, parses the logs, and reports
each file that cannot be used. `produce` decodes the images of one trajectory.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.sources.card import SourceCard
from racines_data.sources.folder import FolderSource
from racines_data.sources.images import read_gray, square
from racines_data.sources.release.checks import UNIT_KINDS, UNITS
from racines_data.sources.release.kinds import Kind, flagged
from racines_data.sources.release.log import CONTROL, POSE, TIME, WRENCH, parse_log
from racines_data.sources.release.survey import FolderSurvey, Surveyor
from racines_data.sources.release.tree import Pair, SweepFolder, find_recordings
from racines_data.views import RANDOM, VIEWS

_THREADS = 4

CARD = SourceCard(
    origin="the published RACINES recordings, imported",
    rights=("As the published recordings; see their publisher. This import adds no rights."),
    like_paper=True,
    collection=(
        "The published RACINES recordings, imported: an operator moved a UR5e arm that holds "
        "a phased-array probe over a CAE Blue Phantom cardiac block."
    ),
    collection_type="Direct measurement",
    annotation="The recordings name a target view a folder and have no grades.",
    biases="One manufactured block and one arm; anatomy and pathology do not vary.",
    limitations=(
        "A phantom is not a patient. Neighbouring frames of a sweep are near-copies: split by "
        "trajectory only. There are no grades."
    ),
    personal="None: images of a manufactured phantom.",
    limits=(
        "A manufactured phantom, not a patient. Neighbouring frames are near-copies: keep "
        "trajectories whole. There are no grades until a grader has annotated them."
    ),
)


@dataclass(frozen=True)
class ReleaseConfig:
    """How the published recordings are read."""

    unit: str = "m"
    """Unit of the positions in the logs: `m` or `mm`."""
    reach: float = 2.0
    """Farthest that the probe can be from the robot's base, m."""
    tolerance: float = 1e-3
    """Largest error of a rotation's orthonormality, per element of R Rᵀ - 1."""
    allow_absent: bool = False
    """Read a force or control effort that is all NaN as not measured, instead of refusing it."""
    allow_repeats: bool = False
    """Keep a frame whose time is that of the frame before: a coarse clock, or a stale log."""
    label_views: bool = False
    """Take the folder as the view of each of its frames. Frames on the way to a view are then
    labelled as that view, which they are not."""
    views: tuple[str, ...] = VIEWS
    """Names of the view folders, beside `Full`."""


@dataclass(frozen=True)
class ReleaseUnit(Unit):
    """One image folder."""

    images: Path
    logs: Path
    pairs: tuple[Pair, ...]
    """Frames that are kept, in order."""


@dataclass
class ReleaseSource(FolderSource):
    """Reads a folder of published recordings."""

    config: ReleaseConfig
    name = "release"
    version = "1.0.0"
    Config = ReleaseConfig
    card = CARD

    def __post_init__(self) -> None:
        """Name the labels."""
        super().__post_init__()
        self.labels = (*self.config.views, RANDOM)

    @classmethod
    def check_settings(cls, settings: ReleaseConfig) -> None:
        """Refuse an unknown unit."""
        if settings.unit not in UNITS:
            raise RacinesError(f"data.release.unit {settings.unit!r}: choose m or mm")

    def plan(self) -> list[ReleaseUnit]:
        """Check every file, report what cannot be used, and return the trajectories in order.

        Raises:
            RacinesError: the folder is not a release, or its positions have another unit.
        """
        self.report = []
        recordings = find_recordings(self.root, self.config.views, self.report)
        surveys: list[FolderSurvey] = []
        with ThreadPoolExecutor(_THREADS) as pool, progress_bar(self.progress) as bar:
            surveyor = Surveyor(self.root, self.config, self.report, pool)
            for recording in bar.track(recordings, description="checking folders"):
                surveys.append(surveyor.survey(recording))
        self._inputs = hashlib.sha256(b"".join(survey.digest for survey in surveys)).hexdigest()
        found = [pair for pair in zip(recordings, surveys, strict=True) if pair[1].pairs]
        self._check_units(len(found))
        self._flag_sizes(found)
        return [_unit(recording, survey) for recording, survey in found]

    def produce(self, unit: Unit) -> Trajectory:
        """Read a trajectory: 128×128 gray images, poses in metres and radians, N and N·m."""
        assert isinstance(unit, ReleaseUnit)
        texts = (_read_text(unit.logs / pair.log) for pair in unit.pairs)
        rows = np.array([parse_log(text) for text in texts])
        images = [square(read_gray(unit.images / pair.image)) for pair in unit.pairs]
        label = self.labels.index(unit.target_view) if self.config.label_views else -1
        return Trajectory(
            id=unit.id,
            session=unit.session,
            target_view=unit.target_view,
            images=np.stack(images),
            parameters=_parameters(rows, UNITS[self.config.unit]),
            timestamps=rows[:, TIME].copy(),
            controls=rows[:, CONTROL].astype(np.float32),
            views=np.full(len(rows), label, np.int64),
            grades=np.full(len(rows), np.nan, np.float32),
        )

    def _check_units(self, kept: int) -> None:
        for unit, kind in UNIT_KINDS.items():
            wrong = [f for f in self.report if f.refused and f.reason.startswith(f"{kind}:")]
            if wrong and not kept:
                raise RacinesError(
                    f"{self.root}: {kind}: the whole set is likely in {unit}: every readable "
                    f"position is; set data.release.unit to {unit}. First: {wrong[0].file}: "
                    f"{wrong[0].reason}"
                )

    def _flag_sizes(self, found: Sequence[tuple[SweepFolder, FolderSurvey]]) -> None:
        usual = found[0][1].size if found else (0, 0)
        for recording, (pairs, size, _) in found:
            if size != usual:
                detail = f"{size[0]}×{size[1]} here, {usual[0]}×{usual[1]} in {found[0][0].where}"
                count = len(pairs)
                self.report.append(flagged(Kind.MIXED_SIZES, recording.where, detail, "", count))


def _unit(recording: SweepFolder, survey: FolderSurvey) -> ReleaseUnit:
    return ReleaseUnit(
        id=recording.id,
        session=recording.session,
        target_view=recording.target_view,
        frames=len(survey.pairs),
        images=recording.images,
        logs=recording.logs,
        pairs=tuple(survey.pairs),
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError as error:
        raise RacinesError(f"{path}: cannot be read ({error}); import again") from error


def _parameters(rows: np.ndarray, metres: float) -> np.ndarray:
    """Return (T, 12) float32 parameters of (T, 29) logs."""
    matrices = torch.from_numpy(rows[:, POSE].reshape(-1, 4, 4))
    pose = Pose(matrices[:, :3, 3] * metres, matrices[:, :3, :3])
    wrench = torch.from_numpy(rows[:, WRENCH].copy())
    return pose_to_parameters(pose, wrench).to(torch.float32).numpy()
