"""Rows of who estimates motion: the sweeps that they were scored on, their numbers made again."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, holds, tell, told, unknown
from racines_leaderboard.board.collect import Record
from racines_models.protocol import Run
from racines_models.statistics import Figures
from racines_models.trackerless import protocol
from racines_models.trackerless.scoring import (
    MotionScores,
    asked,
    described,
    estimate_all,
    score_motion,
)
from racines_models.trackerless.sweeps import Sweep, SweepSet, digest_of
from racines_models.training.sets import train_seeds


def scored_on(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the dataset, its sweeps, and the settings that motion was scored by."""
    scores, config = record["scores"], bench.motion_scores
    claimed = scores["dataset"]
    recipe = bench.recipe_with(claimed["config"])
    if recipe is None:
        reason = f"no settings of board {bench.board} here that name a recipe: give --params"
        yield unknown("dataset.recipe_digest", reason, claimed["recipe_digest"])
    else:
        reason = "the recipe that the board's settings build"
        yield equal("dataset.recipe_digest", claimed["recipe_digest"], recipe, reason)
    yield equal("dataset.split", claimed["split"], config.split, "motion_scores.split")
    reason = "motion_scores of the board's settings"
    yield equal("settings", scores["settings"], described(config), reason)
    yield from _learned(scores)
    sweeps = bench.sweeps_for(record)
    if sweeps is None:
        for key in ("source", "version", "digest", "sweeps"):
            yield unknown(f"dataset.{key}", bench.no_data, claimed[key])
        return
    card, reason = sweeps.card, f"the dataset in {sweeps.store.root}"
    for key in ("source", "version"):
        yield equal(f"dataset.{key}", claimed[key], card[key], reason)
    built = "the same recipe, built elsewhere: a few pixels differ"
    say, reason = (holds, reason) if claimed["digest"] == card["digest"] else (told, built)
    yield say("dataset.digest", reason, claimed["digest"], card["digest"])
    found = asked(sweeps, config)
    reason = "digest of the frames of each sweep"
    yield equal("dataset.sweeps", claimed["sweeps"], digest_of(found), reason)
    names = {str(each.number): each.id for each in found}
    yield equal("sweeps", scores["sweeps"], names, "the sweeps of the split, by number")


def _learned(scores: dict[str, Any]) -> Iterator[Verdict]:
    """Check what was learned from against what was scored on: one dataset, one digest."""
    learned, claimed = scores.get("learned_from") or {}, scores["dataset"]
    if learned.get("recipe_digest") == claimed["recipe_digest"]:
        reason = "the digest of the dataset that it was scored on, whose recipe it names"
        yield equal("learned_from.digest", learned.get("digest"), claimed["digest"], reason)


def items(subject: str, figures: Figures, record: Record, bench: Bench) -> Verdict:
    """Check that figures are of the sweeps, each once, with the patient who was scanned."""
    sweeps = bench.sweeps_for(record)
    if sweeps is None:
        return unknown(subject, bench.no_data)
    assert figures.items is not None and figures.units is not None
    unit = {each.number: each.unit for each in sweeps.sweeps(bench.motion_scores.split)}
    right = [unit.get(item) for item in figures.items.tolist()] == figures.units.tolist()
    right = right and sorted(figures.items.tolist()) == sorted(unit)
    return tell(right, subject, "every sweep of the split, once, with who was scanned")


def counts(record: Record, bench: Bench) -> dict[str, tuple[int, str]]:
    """Return the n that each metric must have, and why; nothing where the data are not here."""
    sweeps = bench.sweeps_for(record)
    if sweeps is None:
        return {}
    n = sweeps.count(bench.motion_scores.split)
    return dict.fromkeys(record["scores"]["metrics"], (n, "sweeps of the split"))


def score_run(record: Record, bench: Bench, folder: Path, first: bool = False) -> MotionScores:
    """Return the scores of an estimator: of a run's folder, or of one that learns nothing.

    Args:
        record: Names it.
        bench: Has the sweeps and the settings.
        folder: Of the run, with its further trainings.
        first: Score the first training alone.
    """
    name, (sweeps, found) = record["name"], _ground(record, bench)
    settings = section(bench.settings or {}, ("motions", name))
    estimators = protocol.open_estimators(name, folder, settings)
    about = protocol.told_of(estimators, folder)
    estimators = estimators[:1] if first else estimators
    motions = estimate_all(estimators, sweeps, found)
    return score_motion(name, motions, sweeps, bench.motion_scores, about)


def score_trained(record: Record, bench: Bench, folder: Path) -> MotionScores:
    """Train an estimator by the board's settings in a folder, if it trains; return its scores."""
    name, (sweeps, _) = record["name"], _ground(record, bench)
    cls, settings = protocol.estimator_class(name), bench.settings or {}
    if not cls.trained:
        return score_run(record, bench, folder)
    config: Any = fill(cls.Config, section(settings, ("motions", name)), f"motions.{name}")
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    run = Run(folder, settings.get("seed", 0), "cpu", progress=False)
    train_seeds(lambda one: cls(config).fit(sweeps, one), run, repeats)
    return score_run(record, bench, folder)


def _ground(record: Record, bench: Bench) -> tuple[SweepSet, list[Sweep]]:
    sweeps = bench.sweeps_for(record)
    if sweeps is None:
        raise RacinesError(bench.no_data)
    return sweeps, asked(sweeps, bench.motion_scores)
