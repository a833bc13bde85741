"""Settings of a study of what servos learn from images, and what is told of its points."""

from dataclasses import dataclass, fields

from racines_data.errors import RacinesError
from racines_data.patients.splits import seeds_of
from racines_data.views import VIEWS
from racines_envs.agents.servo.frames import FrameConfig
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.agents.servo.visits import VisitConfig
from racines_models.scores.on_patients import PatientScoresConfig
from racines_models.statistics.intervals import BLOCKS

METRICS = {
    "ssim": 1, "ms_ssim": 1, "psnr": 1, "kid": -1, "fid": -1, "pose_error_mm": -1,
    "pose_error_deg": -1, "dice": 1,
}  # fmt: skip
"""Metrics of the images, and whether more or less of each is better."""
OUTCOMES = {
    "success_declared": "rate", "success_true": "rate", "declared": "rate", "reached": "rate",
    "final_grade": "mean", "position_error": "mean", "rotation_error": "mean",
}  # fmt: skip
"""What is told of the servos, and the statistic that it is."""
WIDTHS, LEAST = 5, 8
"""Widths of a servo's network; of fewer channels oneDNN's gradients are known to crash."""


@dataclass(frozen=True)
class LessonConfig:
    """How each patient is examined."""

    frames: int = 1_000
    """Frames a patient, less those at poses where no probe may be."""
    places: int = 8
    """Ways in which a patient lies and is examined, each with a scout: their own, and others'."""
    seed: int = 0
    """Names the scouts."""

    def __post_init__(self) -> None:
        if min(self.frames, self.places) < 1:
            raise RacinesError("downstream.lessons: frames and places are at least 1")

    @property
    def servo(self) -> FrameConfig:
        """The same as settings of a servo's frames; hearts are still."""
        return FrameConfig(self.frames, self.places, moving=0.0)


@dataclass(frozen=True)
class Anchors:
    """Values at 0 and at 1 of the metrics of a board's score, as the board is pinned to them."""

    ssim: tuple[float, ...] = ()
    """Two values, or none."""
    psnr: tuple[float, ...] = ()
    """Two values, or none."""
    kid: tuple[float, ...] = ()
    """Two values, or none."""
    pose_error_mm: tuple[float, ...] = ()
    """Two values, or none."""
    dice: tuple[float, ...] = ()
    """Two values, or none."""

    def __post_init__(self) -> None:
        counts = {len(ends) for ends in self.ends()}
        if counts not in ({0}, {2}):
            raise RacinesError("downstream.anchors: give each metric its value at 0 and at 1")

    @property
    def known(self) -> bool:
        """Whether there are any."""
        return bool(self.ssim)

    def ends(self) -> list[tuple[float, ...]]:
        """Return the two values of each metric of `SCORED`."""
        return [getattr(self, name) for name in SCORED]


SCORED = tuple(each.name for each in fields(Anchors))
"""Metrics of a score."""


@dataclass(frozen=True)
class DownstreamConfig:
    """Who is examined, what is learned, and on whom it is judged."""

    points: tuple[str, ...] = ("truth", "truth:blur=4", "scout-mean")
    """Who draws: see `racines_envs.studies.downstream.points`."""
    patients: int = 20
    """Train patients, the first."""
    lessons: LessonConfig = LessonConfig()
    images: int = 200_000
    """Training images that a servo sees, with repetition."""
    widths: tuple[int, ...] = (16, 24, 48, 96, 128)
    """Channels of the servo's network, multiples of 8."""
    trainings: int = 1
    """Servos a point, from seeds of their own."""
    views: tuple[str, ...] = ("A4C", "PSAV")
    """Views that servos look for."""
    split: str = "validation"
    """Whose patients they are judged on: `validation`, or once `test`."""
    judged: int = 40
    """So many of them, the first."""
    starts: int = 2
    """Episodes on each of them, from each view."""
    read: int = 8
    """Patients of that split whose true frames the servos read; the errors are told."""
    seed: int = 0
    """Names starts, weights and images."""
    pose: str = PatientScoresConfig.pose
    """Folder of the pose regressor of patients."""
    segmentation: str = PatientScoresConfig.segmentation
    """Folder of the segmentation judge."""
    published: str = ""
    """Folder of points as others measured them, which are not measured again; none if empty."""
    anchors: Anchors = Anchors()
    """Of a board whose score is told beside; none if empty."""

    def __post_init__(self) -> None:
        if self.split not in ("validation", "test"):
            raise RacinesError(f"downstream.split: {self.split!r}: choose validation or test")
        counts = {"patients": BLOCKS, "judged": len(seeds_of(self.split))}
        for name, most in (counts | {"read": counts["judged"]}).items():
            if not 0 < getattr(self, name) <= most:
                raise RacinesError(f"downstream.{name}: {getattr(self, name)}: give 1 to {most}")
        unknown = [view for view in self.views if view not in VIEWS]
        if unknown or not self.views or len(set(self.views)) < len(self.views):
            told = f"{', '.join(self.views)}: choose of {', '.join(VIEWS)}, each once"
            raise RacinesError(f"downstream.views: {told}")
        if min(self.trainings, self.starts, self.images) < 1:
            raise RacinesError("downstream: trainings, starts and images are at least 1")
        if len(self.widths) != WIDTHS or any(each < LEAST or each % LEAST for each in self.widths):
            raise RacinesError(f"downstream.widths: give {WIDTHS} multiples of {LEAST}")

    @property
    def servo(self) -> ServoConfig:
        """The settings of a servo's training."""
        return ServoConfig(
            patients=self.patients, validation_patients=1, frames=self.lessons.servo,
            visits=VisitConfig(rounds=0), images=self.images,
        )  # fmt: skip

    @property
    def readers(self) -> tuple[int, ...]:
        """Patients whose true frames are read."""
        return tuple(seeds_of(self.split)[: self.read])
