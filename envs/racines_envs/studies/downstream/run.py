"""What a servo is worth that learned from a generator's images, beside the generator's metrics.

    point ──> its images of train patients ──> a small servo ──> found on validation patients
      └─────> its images at the board's poses of the same patients ──> the board's metrics

All points have the same patients, poses, trainings and starts; what differs is who draws. A point
is a task of minutes, whose result lies in a file of its own: a study that was killed goes on.
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.scouts import POSES, SCOUTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_data.randomness import derive
from racines_data.store.asked import AskedStore
from racines_data.store.frames import Batch
from racines_data.views import VIEWS
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.frames import Frames, kept, places_of
from racines_envs.agents.servo.learner import Bank, ServoConfig, ServoLearner
from racines_envs.agents.servo.visits import VisitConfig
from racines_envs.agents.training import seeded
from racines_envs.evaluation.measures import patient_values
from racines_envs.evaluation.patients import PatientsConfig, act_on_patients, start_set
from racines_envs.studies.downstream.lessons import LessonConfig, examined, lesson, taught
from racines_envs.studies.downstream.points import TRUTH, Point, open_point
from racines_envs.task.names import PATIENTS
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.networks.servo import ServoNetwork
from racines_models.protocol import Run
from racines_models.scores.features import InceptionFeatures, Remembered
from racines_models.scores.features import kept as kept_features
from racines_models.scores.on_patients import Judges, PatientScoresConfig, score_on_patients
from racines_models.statistics import Evidence
from racines_models.training.trainer import train

SCHEMA = "racines.downstream-point/1"
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


@dataclass(frozen=True)
class DownstreamConfig:
    """Who is examined, what is learned, and on whom it is judged."""

    points: tuple[str, ...] = (TRUTH, "truth:blur=4", "scout-mean")
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

    def __post_init__(self) -> None:
        if self.split not in ("validation", "test"):
            raise RacinesError(f"downstream.split: {self.split!r}: choose validation or test")
        for name, most in (("patients", "train"), ("judged", self.split), ("read", self.split)):
            if not 0 < getattr(self, name) <= len(seeds_of(most)):
                raise RacinesError(
                    f"downstream.{name}: {getattr(self, name)}: split {most} has 1 to "
                    f"{len(seeds_of(most))} patients"
                )
        if len(self.widths) != 5 or any(width < 8 or width % 8 for width in self.widths):
            # Of fewer, oneDNN's gradients of images with channels last are known to crash.
            raise RacinesError(f"downstream.widths: {self.widths}: give five multiples of 8")
        if min(self.trainings, self.starts, self.images) < 1 or not self.views:
            raise RacinesError("downstream: trainings, starts, images and views are at least 1")

    @property
    def judges(self) -> tuple[int, ...]:
        """Validation or test patients on whom servos act."""
        return tuple(seeds_of(self.split)[: self.judged])

    @property
    def servo(self) -> ServoConfig:
        """The settings of a servo's training."""
        return ServoConfig(
            patients=self.patients, validation_patients=1, frames=self.lessons.servo,
            visits=VisitConfig(rounds=0), images=self.images,
        )  # fmt: skip


@dataclass(frozen=True)
class OnAsked:
    """A point that draws what the board asks of patients."""

    point: Point
    asked: AskedStore
    name: str = "point"
    stochastic: bool = True
    conditional: bool = True
    trained: bool = field(default=False)

    def draw_frames(self, frames: Batch, seed: int) -> Tensor:
        """Return the (P · 32, 128, 128) images of all that is asked, in order."""
        asked, images = self.asked, []
        for place, patient in enumerate(asked.patients or []):
            rows = slice(place * POSES, (place + 1) * POSES)
            scout = asked.scouts[place][None], asked.scout_parameters[place][None]
            who = examined(patient, places_of(patient, 1), *scout)
            seeds = derive(torch.tensor(seed), patient, torch.arange(POSES))
            where = torch.zeros(POSES, dtype=torch.int64)
            images.append(self.point.draw(who, where, asked.parameters[rows], seeds))
        return torch.cat(images)


def measure_points(
    config: DownstreamConfig, folder: Path, engine: Engine | None = None,
    advance: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Measure all points; return what is told of each, in the order of the settings.

    Args:
        config: all settings.
        folder: keeps what patients have been examined, and a file a point.
        engine: runs a point a task; None: one after the other, here.
        advance: told what is done.

    Raises:
        RacinesError: as `open_point` and `score_on_patients`, before anybody is examined where
            that can be known.
    """
    pool = engine or LocalEngine()
    points = [open_point(spec) for spec in config.points]
    paths = [point_file(point, config, folder) for point in points]
    missing = [spec for spec, path in zip(config.points, paths, strict=True) if not path.is_file()]
    if missing:
        _extractor(_asked(config, folder, engine), folder)  # each task reads them from the folder
        whom = [("train", each) for each in seeds_of("train")[: config.patients]]
        whom += [(config.split, each) for each in config.judges[: config.read]]
        for title in pool.map(_prepare, (config, folder), whom, remedy="to go on"):
            if advance is not None:
                advance(title)
    for title in pool.map(_measure, (config, folder), missing, remedy="to go on"):
        if advance is not None:
            advance(title)
    return [json.loads(path.read_text()) for path in paths]


def point_file(point: Point, config: DownstreamConfig, folder: Path) -> Path:
    """Return where a point's result lies: its name tells all that decides it."""
    settings = {key: value for key, value in asdict(config).items() if key != "points"}
    told = {"schema": SCHEMA, "spec": point.spec, "weights": point.weights, "settings": settings}
    told |= {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION}
    told |= {"judges": [_judge(config.pose), _judge(config.segmentation)]}
    digest = recipe_digest(json.loads(json.dumps(told)))[:16]
    return folder / "points" / f"{digest}.json"


def _judge(folder: str) -> list[str]:
    return sorted(sha256_file(path) for path in Path(folder).glob("*.safetensors"))


def _asked(config: DownstreamConfig, folder: Path, engine: Engine | None = None) -> AskedStore:
    cache = folder / "asked"
    return AskedStore("train", config.patients, config.lessons.seed, cache, engine=engine)


def _prepare(state: tuple[DownstreamConfig, Path], whom: tuple[str, int]) -> str:
    config, folder = state
    split, patient = whom
    if split == "train":
        lesson(patient, config.lessons, folder / "lessons")
    else:
        _true_frames(patient, config, folder)
    return f"patient {patient}"


def _true_frames(patient: int, config: DownstreamConfig, folder: Path) -> Frames:
    """Return the true frames of a patient on whom servos are judged."""
    path = folder / "lessons" / f"true-{patient}-{recipe_digest(asdict(config.lessons))[:16]}"
    learned = lesson(patient, config.lessons, folder / "lessons")
    truth = open_point(TRUTH)
    return kept(path.with_suffix(".safetensors"), lambda: taught(truth, patient, learned))


def _measure(state: tuple[DownstreamConfig, Path], spec: str) -> str:
    """Measure one point, and write its file; return its label."""
    config, folder = state
    began, point = time.perf_counter(), open_point(spec)
    path = point_file(point, config, folder)
    own = path.with_suffix("")
    servos, reading = _servos(point, config, folder, own)
    learned = time.perf_counter() - began
    outcome, found = _judged(servos, config)
    metrics, spread = _metrics(point, config, folder)
    told = {"schema": SCHEMA, "label": point.label, "kind": point.kind(), "spec": point.spec}
    told |= {"weights": point.weights, "metrics": metrics, "pseudo": spread, "reading": reading}
    told |= {"outcome": outcome, "found": found, "seconds_to_learn": round(learned, 1)}
    write_json(path, told | {"seconds": round(time.perf_counter() - began, 1)})
    shutil.rmtree(own, ignore_errors=True)
    return point.label


def _servos(
    point: Point, config: DownstreamConfig, folder: Path, own: Path
) -> tuple[list[ServoAgent], list[dict[str, float]]]:
    """Return servos that learned from a point's images, and how they read true frames."""

    def drawn(patient: int) -> Frames:
        learned = lesson(patient, config.lessons, folder / "lessons")
        return kept(own / f"{patient}.safetensors", lambda: taught(point, patient, learned))

    count = config.lessons.frames
    bank = Bank(seeds_of("train")[: config.patients], count, drawn)
    held = Bank(
        config.judges[: config.read], count, lambda patient: _true_frames(patient, config, folder)
    )
    agents, reading = [], []
    for seed in range(config.seed, config.seed + config.trainings):
        with seeded(seed, 1):
            network = ServoNetwork(len(VIEWS), config.widths)
            learner = ServoLearner(config.servo, bank, held, seed, network)
            run = Run(own / f"seed-{seed}", seed, "cpu", None, progress=False)
            train(learner, None, learner.training, run, learner)
        agents.append(ServoAgent(config.servo, learner.network))
        reading.append({name: round(each, 5) for name, each in learner.history[-1].items()})
    return agents, reading


def _judged(
    servos: Sequence[ServoAgent], config: DownstreamConfig
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the outcomes over all views and in each, and what was found in every episode."""
    values, units = {}, np.array([])
    for view in config.views:
        whom = PatientsConfig(
            f"{view}-{PATIENTS}", config.split, config.judged, config.starts, config.seed,
            chunk=config.judged,
        )  # fmt: skip
        starts = start_set(whom)
        values[view], units = patient_values(act_on_patients(servos, whom, starts)), starts.units

    def told(name: str, views: Sequence[str]) -> dict[str, Any]:
        every = np.concatenate([values[view][name] for view in views], 1)
        figures = Evidence().add(
            name, OUTCOMES[name], every[:, None], np.arange(every.shape[1]),
            np.tile(units, len(views)),
        )  # fmt: skip
        return figures.interval().to_json()

    outcome = {name: told(name, config.views) for name in OUTCOMES}
    outcome["by_view"] = {
        view: {name: told(name, [view]) for name in OUTCOMES} for view in config.views
    }
    found = {
        view: {name: np.round(each[name], 4).tolist() for name in OUTCOMES}
        for view, each in values.items()
    }
    return outcome, found | {"patients": units.tolist()}


def _extractor(asked: AskedStore, folder: Path) -> Remembered:
    """Return an extractor that has looked at the true images, which all points share."""
    inception = InceptionFeatures("cpu")
    key = [asked.manifest["digest"], inception.settings, torch.__version__]
    true = kept_features(folder / "asked", key, lambda: inception(asked.images))
    return Remembered(inception, asked.images, true)


def _metrics(
    point: Point, config: DownstreamConfig, folder: Path
) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Return the board's metrics of a point's images, and their pseudo-values by patient."""
    asked = _asked(config, folder)
    judges = Judges(
        PoseRegressor.load(config.pose), SegmentationJudge.load(config.segmentation),
        _extractor(asked, folder),
    )  # fmt: skip
    whom = PatientScoresConfig("train", config.patients, config.seed)
    scores = score_on_patients([OnAsked(point, asked)], asked, whom, point.label, judges)
    kept_of = scores.evidence.figures
    spread = {name: kept_of[name].replicates().pseudo().tolist() for name in METRICS}
    return {name: scores.content["metrics"][name] for name in METRICS}, spread
