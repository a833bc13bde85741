"""The published RACINES recordings, as people download them; see `tree` for the layout.

A folder is a session and an image folder a trajectory. Its view is the sweep's target: what each
frame shows is not in the files, nor is a grade, so `view` and `grade` stay null.

`plan` reads every file once: it checks the PNGs without decoding them, parses the logs, and reports
each file that cannot be used. `produce` decodes the images of one trajectory.
"""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.sources.card import SourceCard
from racines_data.sources.folder import UNITS, FolderSource, Report, parameters_of, recorded
from racines_data.sources.images import Kind, read_gray, resolution, square
from racines_data.sources.release.log import CONTROL, POSE, TIME, WRENCH, parse_log
from racines_data.sources.release.survey import UNIT_KINDS, ReleaseConfig, Surveyor
from racines_data.sources.release.tree import Pair, SweepFolder, find_recordings
from racines_data.views import RANDOM

_THREADS = 4

CARD = SourceCard(
    origin="the published RACINES recordings, imported",
    rights="As the published recordings; see their publisher. This import adds no rights.",
    like_paper=True,
    collection="The published RACINES recordings, imported: an operator moved a UR5e arm that "
    "holds a phased-array probe over a CAE Blue Phantom cardiac block.",
    collection_type="Direct measurement",
    annotation="The recordings name a target view a folder and have no grades.",
    biases="One manufactured block and one arm; anatomy and pathology do not vary.",
    limitations="A phantom is not a patient. Neighbouring frames of a sweep are near-copies: split "
    "by trajectory only. There are no grades.",
    personal="None: images of a manufactured phantom.",
    limits="A manufactured phantom, not a patient. Neighbouring frames are near-copies: keep "
    "trajectories whole. There are no grades until a grader has annotated them.",
)


@dataclass(frozen=True)
class ReleaseUnit(Unit):
    """One image folder."""

    folder: SweepFolder
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

    @property
    def labels(self) -> tuple[str, ...]:
        """The view folders, then `Random`."""
        return (*self.config.views, RANDOM)

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
        self.report = report = Report(self.root)
        folders = find_recordings(self.config.views, report)
        with ThreadPoolExecutor(_THREADS) as pool, progress_bar(self.progress) as bar:
            surveyor = Surveyor(self.config, report, pool)
            steps = bar.track(folders, description="checking folders")
            surveys = [surveyor.survey(folder) for folder in steps]
        self._inputs = hashlib.sha256(b"".join(survey.digest for survey in surveys)).hexdigest()
        found = [survey for survey in surveys if survey.pairs]
        if not found:
            self._check_units()
        for folder, pairs, size, _ in found:
            first, usual = found[0].folder.images, found[0].size
            if size != usual:
                detail = f"{resolution(size)} here, {resolution(usual)} in {report.place(first)}"
                report.flag(Kind.MIXED_SIZES, folder.images, detail, frames=len(pairs))
        units = []
        for folder, pairs, _, _ in found:
            names = folder.id, folder.session, folder.target_view
            units.append(ReleaseUnit(*names, len(pairs), folder, tuple(pairs)))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Read a trajectory: 128×128 gray images, poses in metres and radians, N and N·m."""
        assert isinstance(unit, ReleaseUnit)
        rows = np.array([parse_log(_read_text(unit.folder.logs / pair.log)) for pair in unit.pairs])
        label = self.labels.index(unit.target_view) if self.config.label_views else -1
        poses, metres = rows[:, POSE].reshape(-1, 4, 4), UNITS[self.config.unit]
        return recorded(
            unit,
            [square(read_gray(unit.folder.images / pair.image)) for pair in unit.pairs],
            parameters=parameters_of(poses, rows[:, WRENCH], metres),
            timestamps=rows[:, TIME].copy(),
            controls=rows[:, CONTROL].astype(np.float32),
            views=np.full(len(rows), label, np.int64),
        )

    def _check_units(self) -> None:
        """Refuse a release of which no frame is left because of the unit."""
        for unit, kind in UNIT_KINDS.items():
            wrong = [f for f in self.report if f.refused and f.reason.startswith(f"{kind}:")]
            if wrong:
                raise RacinesError(
                    f"{self.root}: {kind}: the whole set is likely in {unit}: every readable "
                    f"position is; set data.release.unit to {unit}. First: {wrong[0].file}: "
                    f"{wrong[0].reason}"
                )


def _read_text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError as error:
        raise RacinesError(f"{path}: cannot be read ({error}); import again") from error
