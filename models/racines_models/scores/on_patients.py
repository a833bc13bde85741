"""Scores of generators on patients whom nobody has seen: adapt to a scout, then draw.

    patient ──> scout, 64 frames ──> adapt ──> 32 poses in strata of distance ──> figures

Every figure is over all patients, and again by stratum; intervals resample patients, and trainings
where a method is trained. A generator that does not adapt draws as ever.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.patients.scouts import POSES, check_asked, strata_names
from racines_data.randomness import derive
from racines_data.store.asked import AskedStore
from racines_data.store.frames import Batch
from racines_models.adapting import adapted
from racines_models.contract import declared
from racines_models.generators.noise_ceiling import NoiseCeiling
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.protocol import Adapting
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.registry import (
    generator_class,
    is_file,
    is_predictions,
    open_generator,
    open_runs,
    run_folder,
)
from racines_models.sample import DRAW, FrameSource, Sample, check_drawn
from racines_models.scores.features import Extractor, Remembered
from racines_models.scores.remembered import RememberedOutlines, RememberedPose
from racines_models.scores.scorer import Scorer, ScoresConfig, plain
from racines_models.scores.scoring import SCHEMA, Scores
from racines_models.scores.spread import (
    SpreadExtractor,
    SpreadOutlines,
    SpreadPose,
    can_be_sent,
)

NOTES = [
    "FID is biased upwards by small n: compare only figures of equal n, extractor and patients.",
    "Intervals are over patients and trainings; those of one training say nothing of another.",
    "Strata are of the distance to the nearest frame of the scout, where 1 degree counts 1.2 mm.",
]
BY_STRATUM = (
    "ssim", "psnr", "fid", "kid", "pose_error_mm", "pose_error_deg", "dice", "pose_error_mm_truth",
    "pose_error_deg_truth", "dice_truth",
)  # fmt: skip
"""Figures that are told of each stratum."""


@dataclass(frozen=True)
class PatientScoresConfig:
    """On whom generators are scored, and by whom."""

    split: str = "validation"
    """Whose patients: `train`, `validation` or `test`."""
    patients: int = 40
    """So many of them, the first."""
    seed: int = 0
    """Names scouts and poses, and draws the images."""
    pose: str = "models/weights/phantom-patients/pose"
    """Folder of the pose regressor of patients."""
    segmentation: str = "models/weights/phantom-patients/segmentation"
    """Folder of the segmentation judge."""


class SeenAgain:
    """The bound: what the patient's own heart shows at the same poses, seen a second time."""

    name = NoiseCeiling.name
    stochastic, conditional = False, True


@dataclass(frozen=True)
class Judges:
    """Who judge."""

    pose: PoseRegressor
    segmentation: SegmentationJudge
    features: Extractor


class OnPatients:
    """A generator that finds what it draws by the frame: it adapts to whom the frame is of."""

    def __init__(self, generator: Any, asked: AskedStore, name: str):
        """Draw what is asked of patients with a generator of any kind."""
        self.generator, self.asked, self.name = generator, asked, name
        told = declared(generator)
        self.stochastic, self.conditional = told.stochastic, told.conditional

    def draw_frames(self, frames: Batch, seed: int) -> Tensor:
        """Return the (P · 32, 128, 128) images of all that is asked, in order."""
        assert len(frames.index) == len(self.asked)
        return draw_patients(self.generator, self.asked, seed)[0]


def check_named(spec: str) -> None:
    """Refuse a network in a file, which has no method to adapt."""
    if is_file(spec) and not is_predictions(spec):
        raise RacinesError(
            f"{spec}: an ONNX file draws poses and cannot adapt to a patient: name a generator, or "
            "give the images that it drew, FILE.parquet (racines export poses --tier patients)"
        )


def open_for_patients(
    spec: str, folder: Path | None, published: Sequence[Path] = (), device: str = "cpu",
    settings: dict[str, Any] | None = None, asked: AskedStore | None = None,
) -> list[Any]:  # fmt: skip
    """Return the trainings of a generator for patients; what is not trained needs no run.

    Args:
        spec: a registered generator, `module:Class`, or `FILE.parquet`, images drawn elsewhere.
        folder: of the run; None: that of the name.
        published: folders of further trainings.
        device: where it draws.
        settings: of one that is not trained.
        asked: of a file: what it has to be drawn of.

    Raises:
        RacinesError: unknown, absent or refused, by name; or an ONNX file, which cannot adapt.
    """
    check_named(spec)
    if is_predictions(spec):
        return [open_generator(spec, folder, store=asked)]
    cls: Any = generator_class(spec)
    if cls is NoiseCeiling:
        return [SeenAgain()]
    if not (run_folder(spec, folder) / "config.json").is_file():
        if getattr(cls, "trained", True) is False and hasattr(cls, "adapt"):
            return [cls(fill(cls.Config, settings or {}, f"patient_generators.{cls.name}"))]
        if isinstance(getattr(cls, "name", None), str):
            train = f"racines train generator {cls.name} --tier patients"
            raise RacinesError(f"{folder}: no trained {cls.name} here; run: {train}")
    return list(open_runs(spec, folder, published, device=device))


def draw_patients(
    generator: Any, asked: AskedStore, seed: int, engine: Engine | None = None
) -> tuple[Tensor, float]:
    """Return the (P · 32, 128, 128) images that a generator draws, and mean seconds to adapt.

    An `engine`, started, has a patient a task, if the generator can be sent to workers.

    Raises:
        RacinesError: a scout that it cannot adapt to, poses of another patient, or images that
            cannot be scored.
    """
    if isinstance(generator, SeenAgain):
        return asked.again.flatten(0, 1), 0.0
    if isinstance(generator, FrameSource):
        return check_drawn(generator.draw_frames(asked_sample(asked).frames, seed)), 0.0
    tasks = [
        Asked(
            patient, int(derive(torch.tensor(seed), DRAW, patient)), asked.scouts[place],
            asked.scout_parameters[place], asked.parameters[place * POSES : (place + 1) * POSES],
        )
        for place, patient in enumerate(asked.patients or [])
    ]  # fmt: skip
    pool = engine if engine is not None and can_be_sent(generator) else LocalEngine()
    made = list(pool.map(_draw_patient, generator, tasks, threads=None))
    seconds = sum(each for _, each in made)
    return check_drawn(torch.cat([images for images, _ in made])), seconds / len(tasks)


@dataclass(frozen=True)
class Asked:
    """What is asked of a generator about one patient."""

    patient: int
    seed: int
    scout: Tensor
    """(64, 128, 128) uint8."""
    scout_parameters: Tensor
    """(64, 12) float32."""
    parameters: Tensor
    """(32, 12) float32, to be drawn."""


def _draw_patient(generator: Any, task: Asked) -> tuple[Tensor, float]:
    began = time.perf_counter()
    source: ImageSource = adapted(generator, task.scout, task.scout_parameters, task.seed)
    seconds = time.perf_counter() - began
    check_asked(task.patient, task.scout_parameters, task.parameters)
    seeds = derive(torch.tensor(task.seed), torch.arange(POSES))
    return source.generate(task.parameters, seeds).cpu(), seconds


def asked_sample(asked: AskedStore) -> Sample:
    """Return all that is asked, in order; its units are patients."""
    everything = torch.arange(len(asked))
    return Sample(asked.take(everything), asked.units(everything))


def score_on_patients(
    generators: Sequence[Any], asked: AskedStore, config: PatientScoresConfig, name: str,
    judges: Judges, device: str = "cpu", progress: Callable[[int], None] | None = None,
    engine: Engine | None = None,
) -> Scores:  # fmt: skip
    """Score a generator, one or several trainings of it, on what is asked of patients.

    An `engine`, started, adapts, draws and judges; None: this process. Each training draws with a
    seed of its own; files are of one, that of the poses they were given.

    Raises:
        RacinesError: as `draw_patients`.
    """
    began = time.perf_counter()
    pairs = [
        draw_patients(
            each, asked, config.seed + (0 if isinstance(each, FrameSource) else training), engine
        )
        for training, each in enumerate(generators)
    ]
    if engine is not None:
        judges = Judges(
            SpreadPose(judges.pose, engine), SpreadOutlines(judges.segmentation, engine),
            SpreadExtractor(judges.features, engine),
        )  # fmt: skip
    drawn = [images for images, _ in pairs]
    features = Remembered(judges.features)
    looked = Judges(RememberedPose(judges.pose), RememberedOutlines(judges.segmentation), features)
    sample = asked_sample(asked)
    scorer = Scorer(ScoresConfig(), asked, sample, drawn, None, progress, len(drawn))
    metrics = _figures(scorer, asked, looked)
    metrics |= scorer.plugged(features, metrics)
    seconds = sum(each for _, each in pairs) / len(pairs)
    adapts = isinstance(generators[0], Adapting)
    if adapts:
        rule = "mean over patients, of one scout"
        metrics["seconds_to_adapt"] = plain(seconds, len(asked.trajectories), "s", rule=rule)
    strata = {}
    for place, title in enumerate(strata_names()):
        rows = (asked.strata == place).nonzero().squeeze(1)
        found = _figures(scorer.part(rows), asked, looked)
        strata[title] = {key: found[key] for key in BY_STRATUM if key in found}
    card = dataset_card(asked) | {"split": config.split, "sample": scorer.sample.digest}
    content = {
        "schema": SCHEMA, "generator": name, "dataset": card, "seeds": [config.seed],
        "runs": len(generators),
        "trained": any(_trained(each) for each in generators),
        **({} if isinstance(generators[0], FrameSource) else {"adapts": adapts}),
        "metrics": metrics, "by_stratum": strata,
        "extractors": {
            "inception": features.settings, "pose": judges.pose.settings,
            "segmentation": judges.segmentation.settings,
        },
        "weights": None, "code": code_version(), "environment": environment(device),
        "seconds": round(time.perf_counter() - began, 3), "notes": NOTES,
    }  # fmt: skip
    return Scores(content, scorer.sample, drawn[0], scorer.evidence)


def _trained(generator: Any) -> bool:
    return not isinstance(generator, SeenAgain) and declared(generator).trained is not False


def _figures(scorer: Scorer, asked: AskedStore, judges: Judges) -> dict[str, Any]:
    """Return all figures of a scorer's images that judges give."""
    figures = scorer.likeness() | scorer.distances("", judges.features)
    assert asked.masks is not None and asked.mask_labels is not None
    masks = asked.masks[scorer.sample.frames.index]
    return (
        figures
        | scorer.poses(judges.pose)
        | scorer.overlap(judges.segmentation, masks, asked.mask_labels)
    )
