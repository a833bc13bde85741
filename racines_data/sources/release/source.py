"""The published RACINES recordings, as people download them; see `layout`.

A folder is a session and an image folder a trajectory. Its view is the sweep's target: what each
frame shows is not in the files, nor is a grade, so `view` and `grade` stay null.

`plan` reads every file once: it checks the PNGs without decoding them, parses the logs, and reports
each file that cannot be used. `produce` decodes the images of one trajectory.
"""

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from racines_data.errors import RacinesError
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import SourceCard, Unit
from racines_data.sources.folder import UNITS, FolderSource, Report, parameters_of, recorded
from racines_data.sources.gate.bounds import Bounds
from racines_data.sources.gate.numbers import (
    LENGTH_KINDS,
    LENGTHS,
    backward,
    likely_unit,
    rotation_faults,
)
from racines_data.sources.images import Fault, Kind, check_png, read_gray, resolution, square
from racines_data.sources.release import layout
from racines_data.sources.release.layout import FIELDS, Pair, SweepFolder
from racines_data.sources.table.inputs import Folder, open_folder
from racines_data.views import RANDOM, VIEWS

_CHUNK = 64
_THREADS = 4
UNIT_KINDS = LENGTH_KINDS
_NEAREST = 0.01
"""No recording has the probe nearer to the middle of the robot's base, m."""

_LIKELY = 0.1  # m: nearer than this, another unit is no likelier than a wrong number


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


class FolderSurvey(NamedTuple):
    """What one image folder holds."""

    folder: SweepFolder
    pairs: list[Pair]
    """Frames to keep, in order."""
    size: tuple[int, int]
    """Width and height of their images."""
    digest: bytes
    """Of the names and bytes of all pairs of files."""


@dataclass
class _Frame:
    """One frame's files, and what they hold."""

    pair: Pair
    image: Path
    log: Path
    numbers: list[float] | None = None
    size: tuple[int, int] = (0, 0)
    fault: Fault | None = None
    """Why there are no numbers."""
    digest: bytes = b""


def _read(folder: Folder, frames: list[_Frame]) -> list[_Frame]:
    """Read the files of some frames; return the frames."""
    for frame in frames:
        image = log = b""
        try:
            image = _content(folder, frame.image, Kind.UNREADABLE_IMAGE)
            frame.size = check_png(image)
            log = _content(folder, frame.log, Kind.UNREADABLE_LOG)
            frame.numbers = layout.parse_log(log.decode("utf-8-sig", "replace"))
        except Fault as error:
            frame.fault = error
        except OSError as error:
            kind = Kind.UNREADABLE_LOG if image else Kind.UNREADABLE_IMAGE
            frame.fault = Fault(kind, f"{error.strerror}")
        frame.digest = hashlib.sha256(image).digest() + hashlib.sha256(log).digest()
    return frames


def _content(folder: Folder, path: Path, kind: Kind) -> bytes:
    """Return the bytes of a file of the release; a FIFO would be waited for without end."""
    if reason := folder.fault(path):
        raise Fault(kind, reason)
    return path.read_bytes()


@dataclass
class Surveyor:
    """Checks the image folders of one release, and reports what cannot be used."""

    config: ReleaseConfig
    report: Report
    pool: ThreadPoolExecutor

    def survey(self, folder: SweepFolder) -> FolderSurvey:
        """Read every file of a recording once."""
        pairs = layout.pair_files(folder, self.report)
        frames = [_Frame(p, folder.images / p.image, folder.logs / p.log) for p in pairs]
        digest = hashlib.sha256(self.report.place(folder.images).encode())
        read = partial(_read, open_folder(self.report.root))
        chunks = [frames[start : start + _CHUNK] for start in range(0, len(frames), _CHUNK)]
        for frame in chain.from_iterable(self.pool.map(read, chunks)):
            digest.update(f"{frame.pair.image}\0{frame.pair.log}\0".encode() + frame.digest)
            if frame.fault:
                file = frame.log if frame.size != (0, 0) else frame.image
                self.report.refuse(frame.fault.kind, file, frame.fault.detail, frame.fault.item)
        frames, size = self._one_size([frame for frame in frames if frame.numbers is not None])
        frames = self._in_time(folder, self._sound(folder, frames))
        return FolderSurvey(folder, [frame.pair for frame in frames], size, digest.digest())

    def _one_size(self, frames: Sequence[_Frame]) -> tuple[list[_Frame], tuple[int, int]]:
        """Keep the images of the commonest size: another size is another crop of the screen."""
        sizes = Counter(frame.size for frame in frames)
        usual = max(sizes, key=lambda size: (sizes[size], size), default=(0, 0))
        for frame in frames:
            if frame.size != usual:
                detail = f"{resolution(frame.size)}, {sizes[usual]} others are {resolution(usual)}"
                self.report.refuse(Kind.MIXED_SIZES, frame.image, detail)
        return [frame for frame in frames if frame.size == usual], usual

    def _sound(self, folder: SweepFolder, frames: Sequence[_Frame]) -> list[_Frame]:
        """Keep the frames whose numbers are sound."""
        faults = check_numbers(_rows(frames), self.config)
        kinds = {fault.kind if fault else None for fault in faults}
        first = next(iter(faults), None)
        if first and len(faults) > 1 and len(kinds) == 1 and first.kind in UNIT_KINDS.values():
            # All are in one other unit: a line for the folder, not for each of thousands of frames.
            detail = f"all {len(faults)} frames: {first.detail}"
            self.report.refuse(first.kind, folder.images, detail, first.item, len(faults))
            return []
        for frame, fault in zip(frames, faults, strict=True):
            if fault:
                self.report.refuse(fault.kind, frame.log, fault.detail, fault.item)
        return [frame for frame, fault in zip(frames, faults, strict=True) if not fault]

    def _in_time(self, folder: SweepFolder, frames: Sequence[_Frame]) -> list[_Frame]:
        """Keep the frames in whose order the clock runs on; flag where it may stand still."""
        times = _rows(frames)[:, layout.TIME]
        lost = backward(times.tolist(), self.config.allow_repeats)
        for index in lost:
            detail = f"{times[index]:.6f} s does not go on from its neighbours' times"
            self.report.refuse(Kind.CLOCK, frames[index].log, detail, "Time")
        stopped = int((np.diff(np.delete(times, lost)) == 0).sum())
        if stopped:
            detail = f"{stopped} frames have the time of the frame before; they are kept"
            self.report.flag(Kind.CLOCK, folder.images, detail, "Time", stopped)
        gone = set(lost)
        return [frame for index, frame in enumerate(frames) if index not in gone]


def _rows(frames: Sequence[_Frame]) -> np.ndarray:
    """Return (T, 29) float64."""
    return np.array([frame.numbers for frame in frames], float).reshape(-1, layout.WIDTH)


def check_numbers(rows: np.ndarray, config: ReleaseConfig) -> list[Fault | None]:
    """Return what is wrong with each of (T, 29) logs, or None."""
    faults: list[Fault | None] = [None] * len(rows)
    for index in np.flatnonzero(~np.isfinite(rows).all(1)):
        faults[index] = _not_finite(rows[index], config.allow_absent)
    good = np.flatnonzero([fault is None for fault in faults])
    matrices = rows[good, layout.POSE].reshape(-1, 4, 4)
    rigid = rotation_faults(matrices, config.tolerance, FIELDS[2])
    for index, fault, matrix in zip(good, rigid, matrices, strict=True):
        faults[index] = fault or _wrong_unit(matrix[:3, 3], config.unit, config.reach)
    return faults


def _not_finite(row: np.ndarray, allow_absent: bool) -> Fault | None:
    parts = slice(layout.TIME, 1), layout.WRENCH, layout.POSE, layout.CONTROL
    for name, part in zip(FIELDS, parts, strict=True):
        values = row[part]
        nan, wrong = np.isnan(values), int((~np.isfinite(values)).sum())
        absent = allow_absent and part in (layout.WRENCH, layout.CONTROL) and nan.all()
        if wrong and not absent:
            kind = Kind.NAN if nan.any() else Kind.INFINITE
            return Fault(kind, f"{wrong} of {len(values)} numbers are not finite", name)
    return None


def _wrong_unit(position: np.ndarray, unit: str, reach: float) -> Fault | None:
    distance = float(np.linalg.norm(position))
    if distance * UNITS[unit] <= reach and (unit == "m" or distance * UNITS[unit] >= _NEAREST):
        return None
    read = f"the probe is {distance * UNITS[unit]:.4g} m from the robot when read in {unit}"
    others = {name: metres for name, metres in LENGTHS.items() if name != unit}
    if other := likely_unit(distance, others, _LIKELY, reach):
        return Fault(LENGTH_KINDS[other], f"{read}; the position is likely in {other}", FIELDS[2])
    return Fault(Kind.OUT_OF_REACH, f"{read}; its reach is {reach:g} m", FIELDS[2])


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

    @property
    def bounds(self) -> Bounds:
        """The usual, with the reach and the clock of the settings."""
        return Bounds(reach=self.config.reach, repeats=self.config.allow_repeats)

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
        folders = layout.find_recordings(self.config.views, report)
        with ThreadPoolExecutor(_THREADS) as pool, progress_bar(self.progress) as bar:
            surveyor = Surveyor(self.config, report, pool)
            steps = bar.track(folders, description="checking folders")
            surveys = [surveyor.survey(folder) for folder in steps]
        self._inputs = hashlib.sha256(b"".join(survey.digest for survey in surveys)).hexdigest()
        found = [survey for survey in surveys if survey.pairs]
        if not found:
            self._check_units()
        units = []
        for folder, pairs, size, _ in found:
            first, usual = found[0].folder.images, found[0].size
            if size != usual:
                detail = f"{resolution(size)} here, {resolution(usual)} in {report.place(first)}"
                report.flag(Kind.MIXED_SIZES, folder.images, detail, frames=len(pairs))
            names = folder.id, folder.session, folder.target_view
            units.append(ReleaseUnit(*names, len(pairs), folder, tuple(pairs)))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Read a trajectory: 128×128 gray images, poses in metres and radians, N and N·m."""
        assert isinstance(unit, ReleaseUnit)
        logs = (_read_text(unit.folder.logs / pair.log) for pair in unit.pairs)
        rows = np.array([layout.parse_log(log) for log in logs])
        label = self.labels.index(unit.target_view) if self.config.label_views else -1
        poses, metres = rows[:, layout.POSE].reshape(-1, 4, 4), UNITS[self.config.unit]
        return recorded(
            unit,
            [square(read_gray(unit.folder.images / pair.image)) for pair in unit.pairs],
            parameters=parameters_of(poses, rows[:, layout.WRENCH], metres, self.config.tolerance),
            timestamps=rows[:, layout.TIME].copy(),
            controls=rows[:, layout.CONTROL].astype(np.float32),
            views=np.full(len(rows), label, np.int64),
        )

    def _check_units(self) -> None:
        """Refuse a release of which no frame is left because of the unit."""
        for unit, kind in UNIT_KINDS.items():
            wrong = [f for f in self.report if f.refused and f.reason.startswith(f"{kind}:")]
            if wrong:
                remedy = f"set data.release.unit to {unit}"
                if unit not in UNITS:
                    remedy = f"multiply the positions in its logs by {LENGTHS[unit]:g}"
                raise RacinesError(
                    f"{self.root}: {kind}: the whole set is likely in {unit}: every readable "
                    f"position is; {remedy}. First: {wrong[0].file}: {wrong[0].reason}"
                )


def _read_text(path: Path) -> str:
    try:
        return path.read_text("utf-8-sig", "replace")
    except OSError as error:
        raise RacinesError(f"{path}: cannot be read ({error}); import again") from error
