"""What the servos of a study learn from: the same poses of the same patients, drawn by each point.

    patient ──> K places ──> a scout in each; N poses about its views, and what is true of them
                                                 └─> images of a point ──> a servo's frames

What is true is kept on disk and shared by all points; what differs between them is the images.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors.torch import save_file
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.files import read_tensors, write_once
from racines_data.geometry import pose_to_parameters
from racines_data.patients.patient import PATIENTS_VERSION, Patient
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient, lie_anew
from racines_data.patients.scouts import SCOUTS_VERSION, scout
from racines_data.patients.splits import seeds_of, split_of
from racines_data.randomness import derive
from racines_envs.agents.servo.frames import (
    STREAM,
    Frames,
    place,
    places_of,
    shrink,
    truths,
)
from racines_envs.studies.downstream.config import LessonConfig
from racines_envs.studies.downstream.points import Examined, Point
from racines_models.sample import check_drawn


class Lesson(NamedTuple):
    """Of one patient: what is told to who draws, and what is true of each of N frames."""

    scouts: Tensor
    """(K, 64, 128, 128) uint8."""
    swept: Tensor
    """(K, 64, 12) float32 parameters of the scouts."""
    parameters: Tensor
    """(N, 12) float32 of the probe."""
    rows: Tensor
    """(N,) int64, in which place."""
    seeds: Tensor
    """(N,) int64."""
    ways: Tensor
    scores: Tensor
    grades: Tensor
    """As of `Frames`."""


def lesson(patient: int, config: LessonConfig, folder: Path) -> Lesson:
    """Return a patient's lesson from the folder, or make it and put it there.

    Raises:
        RacinesError: a damaged file.
    """
    told = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "patient": patient}
    digest = recipe_digest(told | asdict(config) | asdict(config.servo))[:16]
    path = folder / f"{patient}-{digest}.safetensors"
    if not path.is_file():
        made = {name: each.contiguous() for name, each in _made(patient, config)._asdict().items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_once(path, partial(save_file, made))
    return Lesson(**read_tensors(path, Lesson._fields))


def _made(patient: int, config: LessonConfig) -> Lesson:
    pool = Pool(places_of(patient, config.places))
    found = scout(pool, config.seed, masks=False)
    seeds = derive(torch.full((config.frames,), STREAM), patient, torch.arange(config.frames))
    placed = place(pool, torch.arange(config.frames) % len(pool), seeds, config.servo)
    parameters = pose_to_parameters(placed.pose, pool.wrench(placed.pose)).float()
    scouts = found.images, found.parameters
    return Lesson(*scouts, parameters, placed.rows, placed.seeds, *truths(pool, placed))


def examined(patient: int, patients: Sequence[Patient], scouts: Tensor, swept: Tensor) -> Examined:
    """Return the examinations of a patient in K places, and somebody else in those places.

    Args:
        patient: the seed.
        patients: as they lie in each place.
        scouts: (K, 64, 128, 128) uint8.
        swept: (K, 64, 12) of the scouts.
    """
    other = draw_patient(_next(patient))
    others = tuple(lie_anew(other, each) for each in patients)
    return Examined(tuple(patients), others, scouts, swept)


def taught(point: Point, patient: int, learned: Lesson) -> Frames:
    """Return what a servo learns from in a point's images of a patient.

    Raises:
        RacinesError: images that are none, or what the generator refuses.
    """
    seeds = derive(learned.seeds, STREAM)
    places = places_of(patient, len(learned.scouts))
    whom = examined(patient, places, learned.scouts, learned.swept)
    images = point.draw(whom, learned.rows, learned.parameters, seeds)
    return Frames(shrink(check_drawn(images)), learned.ways, learned.scores, learned.grades)


def _next(patient: int) -> int:
    """Return the patient after this one in the same split."""
    seeds = seeds_of(split_of(patient))
    return seeds[(list(seeds).index(patient) + 1) % len(seeds)]
