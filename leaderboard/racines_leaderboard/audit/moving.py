"""Rows of who estimates motion: the sweeps that they were scored on, their numbers made again."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import PINS, Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, tell, told, unknown
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.motions import MOVING
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
from racines_models.trackerless.sweeps import EVERY, Sweep, SweepSet, digest_of
from racines_models.training.sets import train_seeds

NO_SWEEPS = "the data that it learned from are not here: name their folder with --data"


def scored_on(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the dataset, its sweeps, and the settings that motion was scored by."""
    scores, config = record["scores"], bench.motion_scores
    claimed = scores["dataset"]
    recipe, reason = bench.recipe_for(record)
    if recipe is None:
        reason = f"no settings of board {bench.board} here that name a recipe: give --params"
        yield unknown("dataset.recipe_digest", reason, claimed["recipe_digest"])
    else:
        yield equal("dataset.recipe_digest", claimed["recipe_digest"], recipe, reason)
    yield equal("dataset.split", claimed["split"], config.split, "motion_scores.split")
    reason = "motion_scores of the board's settings"
    yield equal("settings", scores["settings"], described(config), reason)
    yield from _learned(scores, bench)
    sweeps = bench.sweeps_for(record)
    if sweeps is None:
        for key in ("source", "version", "digest", "sweeps"):
            yield unknown(f"dataset.{key}", bench.no_data, claimed[key])
        return
    card, reason = sweeps.card, f"the dataset in {sweeps.store.root}"
    for key in ("source", "version"):
        yield equal(f"dataset.{key}", claimed[key], card[key], reason)
    yield _digest("dataset", claimed, sweeps)
    found = asked(sweeps, config)
    reason = "digest of the frames of each sweep"
    yield equal("dataset.sweeps", claimed["sweeps"], digest_of(found), reason)
    names = {str(each.number): each.id for each in found}
    yield equal("sweeps", scores["sweeps"], names, "the sweeps of the split, by number")


def _learned(scores: dict[str, Any], bench: Bench) -> Iterator[Verdict]:
    """Check what was learned from: against what was scored on, or against the data here."""
    learned, claimed = scores.get("learned_from") or {}, scores["dataset"]
    if learned.get("recipe_digest") == claimed["recipe_digest"]:
        reason = "the digest of the dataset that it was scored on, whose recipe it names"
        yield equal("learned_from.digest", learned.get("digest"), claimed["digest"], reason)
        if claimed["split"] == EVERY:
            yield fails("learned_from", "it was scored on what it learned from", claimed["split"])
    elif learned and (sweeps := bench.sweeps_of(learned)) is not None:
        reason = f"the dataset in {sweeps.store.root}"
        for key in ("source", "version"):
            yield equal(f"learned_from.{key}", learned.get(key), sweeps.card[key], reason)
        yield _digest("learned_from", learned, sweeps)


def _digest(part: str, claimed: dict[str, Any], sweeps: SweepSet) -> Verdict:
    """Say of the content digest of data whether it is that of the data here, of one recipe."""
    same = claimed.get("digest") == sweeps.card["digest"]
    built = "the same recipe, built elsewhere: a few pixels differ"
    reason = f"the dataset in {sweeps.store.root}" if same else built
    say = holds if same else told
    return say(f"{part}.digest", reason, claimed.get("digest"), sweeps.card["digest"])


def learned_on(record: Record, bench: Bench) -> SweepSet | None:
    """Return the sweeps here if they are of the data that a record's estimator learned from."""
    scores = record["scores"]
    return bench.sweeps_of(scores.get("learned_from") or scores["dataset"])


def lacks_to_learn(record: Record, bench: Bench) -> str | None:
    """Say what is not here of what an estimator learned from; None if nothing, or nobody did."""
    learns = record["track"] in MOVING and record["scores"]["trained"]
    return NO_SWEEPS if learns and learned_on(record, bench) is None else None


def board_learned_on(record: Record, bench: Bench) -> Bench | None:
    """Return the board here whose data an estimator learned from, if not those it is scored on."""
    learned, scored = record["scores"].get("learned_from") or {}, record["scores"]["dataset"]
    recipe = learned.get("recipe_digest")
    if recipe in (None, scored["recipe_digest"]):
        return None
    paths = sorted(bench.places.results.glob(f"*/{PINS}"))
    others = (Bench(path.parent.name, bench.places) for path in paths)
    return next((each for each in others if recipe in each.recipes and each.settings), None)


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
    """Train an estimator by the board's settings in a folder, if it trains; return its scores.

    It learns from the data that the record names, which need not be those that it is scored on.
    """
    name, sweeps = record["name"], learned_on(record, bench)
    cls, settings = protocol.estimator_class(name), bench.settings or {}
    if not cls.trained:
        return score_run(record, bench, folder)
    if sweeps is None:
        raise RacinesError(NO_SWEEPS)
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
