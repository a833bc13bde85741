"""Rows of generators on patients: what they were asked for, and their numbers made again."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.scouts import POSES
from racines_data.patients.splits import seeds_of
from racines_data.store.asked import asked_digest
from racines_data.store.scouts import FOLDER, ScoutsConfig, ScoutStore
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, tell, unknown
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.tracks import SCOUTS
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.protocol import Run
from racines_models.registry import generator_class, weights_of
from racines_models.scores.features import InceptionFeatures
from racines_models.scores.on_patients import (
    Judges,
    open_for_patients,
    score_on_patients,
)
from racines_models.scores.scoring import Scores
from racines_models.statistics import Figures
from racines_models.training.sets import train_seeds

JUDGES = "pose", "segmentation"
"""Who judge generators on patients."""


def asked(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check world, split, patients, poses and seeds that a generator was scored on."""
    if bench.settings is None:
        yield unknown("dataset", bench.no_settings)
        return
    claimed, config = record["scores"]["dataset"], bench.patient_scores
    recipe = asked_digest(config.split, config.patients, config.seed)
    reason = "the patients, scouts and poses of the board's settings"
    for key in ("digest", "recipe_digest"):
        yield equal(f"dataset.{key}", claimed[key], recipe, reason)
    yield equal("dataset.source", claimed["source"], SCOUTS, "what is asked of patients")
    yield equal("dataset.version", claimed["version"], PATIENTS_VERSION, "the world here")
    yield equal("dataset.split", claimed["split"], config.split, "patient_scores.split")
    yield equal("seeds", record["scores"]["seeds"], [config.seed], "patient_scores.seed")


def asked_items(subject: str, figures: Figures, bench: Bench) -> Verdict:
    """Check that figures are of the poses that are asked for, each of its own patient."""
    assert figures.items is not None and figures.units is not None
    config = bench.patient_scores
    patients = seeds_of(config.split)[: config.patients]
    items = figures.items.tolist()
    known = set(range(len(patients) * POSES))
    right = set(items) <= known and len(set(items)) == len(items)
    right = right and [patients[item // POSES] for item in items] == figures.units.tolist()
    return tell(right, subject, "each a pose that is asked for, once, of its own patient")


def score_run(record: Record, bench: Bench, folder: Path, further: Sequence[Path] = ()) -> Any:
    """Return the scores of a generator, its trainings in folders, by the judges it names.

    Scouts and what is asked are drawn anew by the bench: no former run is looked at.

    Raises:
        RacinesError: a judge that is not here.
    """
    config, name = bench.patient_scores, record["name"]
    pose, outlines = (judge_of(kind, record, bench) for kind in JUDGES)
    if pose is None or outlines is None:
        raise RacinesError(f"{name}: its judges are not here")
    judges = Judges(
        PoseRegressor.load(pose), SegmentationJudge.load(outlines), InceptionFeatures("cpu")
    )
    own = section(bench.settings or {}, "patient_generators").get(name)
    generators = open_for_patients(name, folder, further, settings=own)
    scores = score_on_patients(generators, bench.asked, config, name, judges)
    there = (folder / "config.json").is_file()
    weights = (weights_of(name, folder, further) if there else None) or None
    content: dict[str, Any] = scores.content | {"weights": weights}
    content["dataset"]["board"] = bench.board
    return Scores(content, scores.sample, scores.images, scores.evidence)


def score_trained(record: Record, bench: Bench, folder: Path) -> Any:
    """Train a generator by the board's settings in a folder, and return its scores."""
    assert bench.settings is not None
    name = record["name"]
    cls: Any = generator_class(name)
    learns = "training" in {each.name for each in dataclasses.fields(cls.Config)}
    if learns and name not in section(bench.settings, "patient_generators"):
        raise RacinesError(
            f"{name}: board {bench.board} has no settings patient_generators.{name}: it was "
            "trained on one heart, for another board: train it there, or leave --retrain out"
        )
    stated = section(bench.settings, "patient_generators").get(name) or {}
    config: Any = fill(cls.Config, stated, f"patient_generators.{name}")
    scouts = fill(ScoutsConfig, section(bench.settings, "scouts"), "scouts")
    store = ScoutStore(bench.places.runs / FOLDER.name, scouts)
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    run = Run(folder, bench.settings.get("seed", 0), "cpu", progress=False)
    train_seeds(lambda one: cls(config).fit(store, one), run, repeats)
    return score_run(record, bench, folder)


def judge_of(kind: str, record: Record, bench: Bench) -> Path | None:
    """Return the folder of the judge of a kind that a record names, if it is here."""
    named = record["scores"].get("extractors", {}).get(kind)
    return bench.judge(kind, named.get("sha256") if isinstance(named, dict) else None)
