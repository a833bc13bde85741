"""The figures of each item that lie beside a record: what follows from them, what they are of.

Every value and interval of a record that has evidence must follow from it alone. What was made
again speaks of the items: those of the trainings that were made again, one by one. So nothing that
pairs the items of two methods can rest on made-up ones.
"""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.evaluation.agent_specs import SECTIONS
from racines_envs.evaluation.measures import by_seed_of
from racines_envs.evaluation.patients import by_pathology_of
from racines_leaderboard.audit import moving
from racines_leaderboard.audit.adapting import asked_items
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.leaves import MISSING, leaves, same
from racines_leaderboard.audit.numbers import starts_of
from racines_leaderboard.audit.verdicts import (
    DIFFERS,
    FAILS,
    RETRAINABLE,
    Verdict,
    equal,
    fails,
    holds,
    tell,
    unknown,
)
from racines_leaderboard.audit.weights import first_training, hours_of, named, run_called
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.ranges import CLOSE, ENDS, range_of
from racines_leaderboard.records.tracks import PATIENT_AGENTS, PATIENT_GENERATORS, TRACK
from racines_models.statistics import Evidence, Figures
from racines_models.training.checkpoint import PREFIX

OF_TRUE_FRAMES = re.compile(r".+_truth|(ssim|psnr|feature_distance|fid|kid)_(neighbour|train)")
"""Figures that rest on no training: what judges say of true frames, and true frames of others."""


def read_evidence(record: Record, path: Path) -> tuple[Evidence | None, Verdict | None]:
    """Return what lies beside a record, and whether it is what the record names.

    Both are None for a record that names none.
    """
    claimed, beside = record["scores"].get("evidence"), path.with_suffix(".parquet")
    if claimed is None:
        return None, None
    if claimed["file"] != beside.name:
        return None, fails(
            "evidence.file", "it lies beside the record", claimed["file"], beside.name
        )
    if not beside.is_file():
        return None, unknown("evidence", f"{beside} is not here", claimed["sha256"])
    verdict = equal("evidence.sha256", claimed["sha256"], sha256_file(beside), f"the file {beside}")
    if verdict.verdict == FAILS:
        return None, verdict
    try:
        return Evidence.read(beside), verdict
    except RacinesError as error:
        return None, fails("evidence", str(error))


def check_evidence(record: Record, evidence: Evidence, bench: Bench) -> Iterator[Verdict]:
    """Check that a record's metrics follow from its evidence, and that it is of their items."""
    scores, runs = record["scores"], record["scores"].get("runs", 1)
    for key, metric in scores["metrics"].items():
        figures = evidence.figures.get(key)
        if figures is not None:
            yield from _follows(key, metric, figures, runs)
            yield from _of_items(key, figures, record, bench)
        elif key in TRACK[record["track"]].ranked_by and metric["value"] is not None:
            yield fails(f"evidence.{key}", "it ranks, and no figures of it are kept")
    if TRACK[record["track"]].steers:
        yield _parts(record, evidence)
    if stray := sorted(set(evidence.figures) - set(scores["metrics"])):
        yield fails("evidence", f"figures of what the record does not have: {', '.join(stray)}")


def _follows(key: str, metric: dict[str, Any], figures: Figures, runs: int) -> Iterator[Verdict]:
    subject = f"evidence.{key}"
    try:
        found = figures.interval()
    except ValueError as error:
        yield fails(subject, f"nothing follows from it: {error}", metric["value"])
        return
    least, most = range_of(key)
    right = _near(metric["value"], found.value) and metric["n"] == found.n
    for end in ENDS[1:]:
        wanted = getattr(found, end)
        cut = None if wanted is None else min(max(wanted, least), most)
        right &= _near(metric[end], wanted) or _near(metric[end], cut)
    claimed, here = ([one[part] for part in (*ENDS, "n")] for one in (metric, vars(found)))
    yield tell(right, subject, "value, interval and n follow from it", claimed, here)
    said = metric.get("settings", {})
    for part, wanted in (("units", found.units), ("trainings", found.trainings)):
        yield equal(f"{subject}.{part}", said.get(part), wanted, "its own count")
    yield equal(f"{subject}.interval", said.get("interval"), found.method, "how it was made")
    level = None if found.low is None else found.level
    yield equal(f"{subject}.level", said.get("level"), level, "what such intervals cover")
    trained = 1 if OF_TRUE_FRAMES.fullmatch(key) else runs
    yield equal(f"{subject}.runs", found.trainings, trained, "the trainings that were scored")


def _parts(record: Record, evidence: Evidence) -> Verdict:
    """Say whether the figures of each start set, or of each pathology, follow from the episodes."""
    scores = record["scores"]
    kind = "by_pathology" if record["track"] == PATIENT_AGENTS.name else "by_seed"
    subject = f"evidence.{kind}"
    try:
        sets = kind == "by_seed"
        found = by_seed_of(evidence, scores["seeds"]) if sets else by_pathology_of(evidence)
    except ValueError as error:
        return fails(subject, f"nothing follows from it: {error}")
    claimed, here = (dict(leaves(one)) for one in (scores.get(kind), json.loads(json.dumps(found))))
    for key in dict.fromkeys((*claimed, *here)):
        stated, made = claimed.get(key, MISSING), here.get(key, MISSING)
        number = isinstance(stated, float) and isinstance(made, float)
        if not (_near(stated, made) if number else same(stated, made)):
            both = (None if each is MISSING else each for each in (stated, made))
            return fails(f"{subject}.{key}", "it follows otherwise from the episodes", *both)
    return holds(subject, f"all {len(here)} leaves follow from the episodes")


def _near(claimed: float | None, found: float | None) -> bool:
    if claimed is None or found is None:
        return claimed is found
    return math.isclose(claimed, found, rel_tol=CLOSE, abs_tol=CLOSE)


def _of_items(key: str, figures: Figures, record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check that items and units are those of the sample's frames, or of the starts."""
    if figures.items is None or figures.units is None:
        return
    subject, items = f"evidence.{key}.items", figures.items.tolist()
    if TRACK[record["track"]].steers:
        if starts := starts_of(record):
            episodes = set(range(starts[0] * starts[1]))
            right = set(items) <= episodes and len(set(items)) == len(items)
            yield tell(right, subject, "each an episode from the starts, once")
        return
    if record["track"] == PATIENT_GENERATORS.name:
        yield asked_items(subject, figures, bench)
        return
    if record["track"] in MOVING:
        yield moving.items(subject, figures, record, bench)
        return
    if bench.data_for(record) is None:
        yield unknown(subject, bench.no_data)
        return
    sample = bench.sample
    unit = dict(zip(sample.frames.index.tolist(), sample.trajectory.tolist(), strict=True))
    frames = [unit.get(item) for item in items] == figures.units.tolist()
    right = frames and len(set(items)) == len(items)
    yield tell(right, subject, "each a frame of the sample, once, with its trajectory")


def compare_evidence(
    record: Record, claimed: Evidence, made: Evidence, bounds: dict[str, float]
) -> Iterator[Verdict]:
    """Hold the figures of each item against those made again, of the trainings that were.

    They may be off by a metric's bound on the average of the items.
    """
    for key in record["scores"]["metrics"]:
        there, here = claimed.figures.get(key), made.figures.get(key)
        if there is None or here is None:
            continue
        subject, bound = f"evidence.{key}.each", bounds.get(key, 0.0)
        off = _apart(there, here)
        if off is None:
            yield fails(subject, "recomputed: of other items, units or draws")
        else:
            say = holds if off <= bound else fails
            told = "equal to the last bit" if off == 0.0 else f"{DIFFERS} {off:.2g} on average"
            yield say(subject, f"recomputed, each item: {told}")


def _apart(there: Figures, here: Figures) -> float | None:
    """Return the mean difference of the trainings that both have; None if of other items."""
    if there.statistic != here.statistic:
        return None
    a, b = _table(there), _table(here)
    both = min(len(a), len(b))
    a, b = a[:both], b[:both]
    sizes = [(x.whole.n, x.whole.units) if x.whole is not None else None for x in (there, here)]
    if a.shape != b.shape or sizes[0] != sizes[1] or not _same_items(there, here):
        return None
    if (np.isnan(a) != np.isnan(b)).any():
        return None
    apart = np.abs(a - b)
    # Replicates of a set are few, and each is a value of its own.
    over = np.nanmax if there.whole is not None else np.nanmean
    return float(over(apart)) if np.isfinite(apart).any() else 0.0


def _table(figures: Figures) -> np.ndarray:
    """Return (R, …) values, a training first."""
    if (of_set := figures.whole) is not None:
        return np.column_stack([of_set.whole, of_set.without])
    assert figures.values is not None
    return figures.values


def _same_items(there: Figures, here: Figures) -> bool:
    pairs = ((there.items, here.items), (there.units, here.units))
    return all(
        (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))
        for a, b in pairs
    )


def further_trainings(record: Record, evidence: Evidence | None, bench: Bench) -> Iterator[Verdict]:
    """Say of the trainings beyond the first, if they were not made again, what is there of them."""
    settings, scores = bench.settings or {}, record["scores"]
    first, runs, weights = settings.get("seed", 0), scores.get("runs", 1), named(record)
    if TRACK[record["track"]].steers:
        yield from _trainings(record, bench, range(first, first + runs))
    further = {f"{PREFIX}{seed}" for seed in range(first + 1, first + runs)}
    folders = {name.split("/")[0] for name in set(weights) - set(first_training(weights))}
    hours = hours_of(record, bench)
    sections = ("generators", "patient_generators", "motions", *SECTIONS)
    recipe = any(run_called(record) in settings.get(each, {}) for each in sections)
    needed = {
        "its recipe in the board's settings": recipe,
        "the digests of their weights": folders == further,
        "the figures of each item": evidence is not None,
        "the hours of a training (training.hours of its submission)": hours is not None,
    }
    lacking = [what for what, there in needed.items() if not there]
    if lacking:
        yield unknown("trainings", f"{runs - 1} beyond the first; missing: {'; '.join(lacking)}")
        return
    reason = f"{runs - 1} beyond the first: recipe, digests and figures are here; {hours:.2g} h"
    yield Verdict("trainings", RETRAINABLE, reason, runs)


def _trainings(record: Record, bench: Bench, seeds: range) -> Iterator[Verdict]:
    """Check the seeds of an agent's trainings, and that those said to be published are here."""
    claimed = record["scores"].get("trainings", [])
    told = [each["seed"] for each in claimed]
    yield equal("trainings.seeds", told, list(seeds), "consecutive, from the board's seed on")
    for each in claimed:
        lies = bench.places.policies / bench.board / run_called(record) / f"{PREFIX}{each['seed']}"
        here = lies.is_dir()
        reason = f"whether it lies in {lies}"
        yield equal(f"trainings.{each['seed']}.published", each["published"], here, reason)
