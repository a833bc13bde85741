"""How a point is judged: what its servos find, and what its images score."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.engines import Engine
from racines_data.patients.scouts import POSES
from racines_data.randomness import derive
from racines_data.store.asked import AskedStore
from racines_data.store.frames import Batch
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.frames import places_of
from racines_envs.evaluation.measures import patient_values
from racines_envs.evaluation.patients import PatientsConfig, act_on_patients, start_set
from racines_envs.studies.downstream.config import METRICS, OUTCOMES, DownstreamConfig
from racines_envs.studies.downstream.lessons import examined
from racines_envs.studies.downstream.points import Point
from racines_envs.task.names import PATIENTS
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.scores.features import InceptionFeatures, Remembered
from racines_models.scores.features import kept as kept_features
from racines_models.scores.on_patients import Judges, PatientScoresConfig, score_on_patients
from racines_models.statistics import Evidence

CHUNK = 20
"""Patients in memory at once; no figure depends on it."""


@dataclass(frozen=True)
class OnAsked:
    """A point that draws what the board asks of patients."""

    point: Point
    asked: AskedStore
    name: str = "point"
    stochastic: bool = True
    conditional: bool = True
    trained: bool = False

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


def found_by(
    servos: Sequence[ServoAgent], config: DownstreamConfig
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the outcomes over all views and in each, and what was found in every episode."""
    values, units = {}, np.array([])
    for view in config.views:
        whom = PatientsConfig(
            f"{view}-{PATIENTS}", config.split, config.judged, config.starts, config.seed,
            chunk=min(config.judged, CHUNK),
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

    outcome: dict[str, Any] = {name: told(name, config.views) for name in OUTCOMES}
    outcome["by_view"] = {
        view: {name: told(name, [view]) for name in OUTCOMES} for view in config.views
    }
    found = {
        view: {name: np.round(each[name], 4).tolist() for name in OUTCOMES}
        for view, each in values.items()
    }
    return outcome, found | {"patients": units.tolist()}


def score_images(
    point: Point, config: DownstreamConfig, folder: Path
) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Return the board's metrics of a point's images, and their pseudo-values by patient."""
    asked = asked_of(config, folder)
    judges = Judges(*open_judges(config), true_extractor(asked, folder))
    whom = PatientScoresConfig("train", config.patients, config.seed)
    scores = score_on_patients([OnAsked(point, asked)], asked, whom, point.label, judges)
    figures = scores.evidence.figures
    spread = {name: figures[name].replicates().pseudo().tolist() for name in METRICS}
    return {name: scores.content["metrics"][name] for name in METRICS}, spread


def open_judges(config: DownstreamConfig) -> tuple[PoseRegressor, SegmentationJudge]:
    """Return the judges of poses and of outlines.

    Raises:
        RacinesError: one that is not there.
    """
    return PoseRegressor.load(config.pose), SegmentationJudge.load(config.segmentation)


def asked_of(config: DownstreamConfig, folder: Path, engine: Engine | None = None) -> AskedStore:
    """Return what the board asks of the train patients, from the study's folder."""
    cache = folder / "asked"
    return AskedStore("train", config.patients, config.lessons.seed, cache, engine=engine)


def true_extractor(asked: AskedStore, folder: Path) -> Remembered:
    """Return an extractor that has looked at the true images, which all points share."""
    inception = InceptionFeatures("cpu")
    key = [asked.manifest["digest"], inception.settings, torch.__version__]
    true = kept_features(folder / "asked", key, lambda: inception(asked.images))
    return Remembered(inception, asked.images, true)
