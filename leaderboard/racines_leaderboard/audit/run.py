"""The audit of one record: checks without scoring, then its numbers recomputed or trained anew.

Another training ends elsewhere, but for the same machine. So a metric that was trained again holds
if the new one lies within the old one's 95 % interval. Where all metrics that rank hold, the
record's tier becomes `reproduced`, and what came out is kept in it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_leaderboard.audit import adapting, claims, moving, weights
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.evidence import (
    check_evidence,
    compare_evidence,
    further_trainings,
    read_evidence,
)
from racines_leaderboard.audit.leaves import compare_leaves
from racines_leaderboard.audit.numbers import (
    BITWISE,
    ROUNDING,
    agreement,
    bounds_by_metric,
    check_metrics,
    compare_numbers,
)
from racines_leaderboard.audit.remedies import remedies
from racines_leaderboard.audit.roads import Made, Road, find_road, score_agent, score_fitted
from racines_leaderboard.audit.robustness import check_robustness
from racines_leaderboard.audit.tier import check_reproduced, check_tier, tier_of
from racines_leaderboard.audit.verdicts import (
    DIFFERS,
    HOLDS,
    SKIPPED,
    UNKNOWN,
    Report,
    Verdict,
    equal,
    fails,
    holds,
    told,
    unknown,
)
from racines_leaderboard.board.collect import Record, read_record
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.schema import sealed, write_record
from racines_leaderboard.records.tracks import HELD_OUT, PATIENT_GENERATORS, TRACK
from racines_models.statistics import Evidence

Finder = Callable[[Record, Bench], Road | str]


def audit(path: Path, bench: Bench, quick: bool = False, find: Finder = find_road) -> Report:
    """Audit a record, `<results>/<board>/<track>/<name>.json`.

    Args:
        path: The record.
        bench: Its board's settings, data and judges.
        quick: Recompute no number. What was not recomputed never holds.
        find: Says how its numbers are made again; one that keeps them serves several audits.
    """
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    verdicts = [holds("record", "fits its schema, and stands where it says")]
    verdicts += _check(path, record, bench)
    evidence, named = read_evidence(record, path)
    verdicts += [named] if named is not None else []
    if evidence is not None:
        verdicts += check_evidence(record, evidence, bench)
    how: dict[str, Any] = {}
    if quick:
        verdicts += [
            Verdict(f"metrics.{key}", SKIPPED, "--quick recomputes no number", metric["value"])
            for key, metric in record["scores"]["metrics"].items()
        ]
        verdicts += check_reproduced(record, None, "", "")
    else:
        numbers, how = _recomputed(record, bench, evidence, find)
        settled = {each.subject for each in numbers}
        verdicts = [each for each in verdicts if each.subject not in settled] + numbers
    return _report(record, bench, verdicts, how, quick)


def audit_all(
    paths: Sequence[Path], places: Places, quick: bool = False, engine: Engine | None = None
) -> Iterator[Report]:
    """Give the report of each record, in order, as `audit` does; an engine takes a record a task.

    Its workers read the records and what they rest on by the same paths.
    """
    auditor = Auditor(places, quick)
    yield from (engine or LocalEngine()).map(_audit_one, auditor, paths, threads=None)


class Auditor:
    """Audits records of any board; what a board needs is opened once in each process."""

    def __init__(self, places: Places, quick: bool = False) -> None:
        """Look where `places` say."""
        self.places, self.quick = places, quick
        self._benches: dict[str, Bench] = {}

    def bench(self, path: Path) -> Bench:
        """Return the bench of the board that a record is of."""
        board = path.parts[-3]
        return self._benches.setdefault(board, Bench(board, self.places))


def _audit_one(auditor: Auditor, path: Path) -> Report:
    return audit(path, auditor.bench(path), auditor.quick)


def retrain(path: Path, bench: Bench, into: Path) -> Report:
    """Audit a record by training its system again; write the tier if all that ranks holds.

    The runs are kept in the folder `into`; one that was killed goes on.
    """
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    # The weights that were scored then need not be here: others are made.
    verdicts = [
        told(each.subject, each.reason, each.claimed, each.found)
        if each.verdict == UNKNOWN and each.subject.startswith("weights.")
        else each
        for each in _check(path, record, bench)
    ]
    not_merged = "its code is not merged: only its artefacts can be scored again"
    lacking = bench.lacks_for(record) or moving.lacks_to_learn(record, bench)
    if reason := not_merged if weights.submitted(record) else lacking:
        return _report(record, bench, [*verdicts, unknown("reproduced", reason)], {})
    folder = into / bench.board / record["track"] / record["name"]
    if record["track"] in HELD_OUT:
        again = score_fitted(record, bench, folder)
    elif record["track"] == PATIENT_GENERATORS.name:
        again = Made.of(adapting.score_trained(record, bench, folder))
    elif record["track"] in MOVING:
        again = Made.of(moving.score_trained(record, bench, folder))
    else:
        again = score_agent(record, bench, folder, train=True)
    made = again.scores
    how = {"road": "trained again", "agreement": "interval", "from": "another training"}
    report = _report(record, bench, [*verdicts, *_within(record, made)], how)
    if report.holds:
        keys = ("seeds", "metrics", "weights", "code", "environment")
        # Who estimates motion draws nothing: the seeds are those of the trainings.
        first = (bench.settings or {}).get("seed", 0)
        told_of = {"seeds": list(range(first, first + made.get("runs", 1)))} | made
        earned = {"tier": "reproduced", "reproduced": {key: told_of[key] for key in keys}}
        with locked(path.parents[2]):
            write_record(path, sealed(record | earned))
        return replace(report, tier="reproduced")
    return report


def _read(path: Path, bench: Bench) -> Record | Report:
    """Return a record, or the report that it is damaged or belongs elsewhere."""
    track = TRACK[path.parent.name]
    try:
        return read_record(path, bench.board, track)
    except RacinesError as error:
        return Report(bench.board, track.name, path.stem, "", (fails("record", str(error)),))


def _report(
    record: Record, bench: Bench, verdicts: list[Verdict], how: dict[str, Any], quick: bool = False
) -> Report:
    track, name = record["track"], record["name"]
    report = Report(record["board"], track, name, tier_of(record), tuple(verdicts), how)
    return replace(report, remedies=tuple(remedies(record, bench, report, quick)))


def _check(path: Path, record: Record, bench: Bench) -> Iterator[Verdict]:
    """Give the verdicts that need no scoring; the other records of the track have a say."""
    yield from claims.check_claims(record, bench)
    yield from check_tier(record)
    if record["track"] in HELD_OUT:
        yield from claims.dataset(record, bench)
        yield from claims.drawing_seeds(record, bench)
    elif record["track"] == PATIENT_GENERATORS.name:
        yield from adapting.asked(record, bench)
    elif record["track"] in MOVING:
        yield from moving.scored_on(record, bench)
    else:
        yield from claims.task(record, bench)
    peers = partial(bench.peers, path)  # to look at all others for each is a square
    yield from claims.judges(record, bench, peers)
    yield from claims.beyond_truth(record, peers)
    yield from weights.check_weights(record, bench)
    yield from weights.check_content(record, bench)
    yield from check_robustness(record, path, bench)
    yield from check_metrics(record, bench)


def _recomputed(
    record: Record, bench: Bench, evidence: Evidence | None, find: Finder
) -> tuple[list[Verdict], dict[str, Any]]:
    """Recompute the numbers of a record; return a verdict a number, and how it was done."""
    road = find(record, bench)
    if isinstance(road, str):
        claimed = record["scores"]["metrics"].items()
        verdicts = [unknown(f"metrics.{key}", road, each["value"]) for key, each in claimed]
        return verdicts + list(check_reproduced(record, None, "", "")), {}
    try:
        made = Made.of(road.score())
    except RacinesError as error:
        return [fails("metrics", f"made from {road.source}: {error}")], {"road": road.name}
    again = made.scores
    tier = agreement(record, again, road.name)
    bounds = bounds_by_metric(again, tier, record["track"])
    partly = road.trainings is not None
    verdicts = list(compare_leaves(record, again, bounds, partly))
    if partly:
        verdicts += _of_first(record, evidence, made)
        verdicts += further_trainings(record, evidence, bench)
    else:
        verdicts += compare_numbers(record, again, tier)
    verdicts += _each_item(record, evidence, made, bounds)
    held = (each.reason for each in verdicts if each.verdict == HOLDS)
    apart = tier == BITWISE and any(DIFFERS in reason for reason in held)
    if not partly and not apart:
        verdicts += _digest(record, again, tier)
    if road.name == "fitted":
        verdicts += _fitted(record, again, tier, road.source)
    verdicts += check_reproduced(record, again, road.name, tier)
    how = {"road": road.name, "agreement": ROUNDING if apart else tier, "from": road.source}
    return verdicts, how | {"environment": again["environment"]}


def _digest(record: Record, made: dict[str, Any], tier: str) -> Iterator[Verdict]:
    """Say of another content digest what equal numbers on a machine of the same name tell."""
    if tier != BITWISE or record["track"] not in HELD_OUT:
        return
    claimed, here = (each["dataset"]["digest"] for each in (record["scores"], made))
    reason = "its numbers are those of the data here to the last bit, on such a machine"
    yield equal("dataset.digest", claimed, here, reason)


def _fitted(record: Record, made: dict[str, Any], tier: str, source: str) -> Iterator[Verdict]:
    """Compare what was fitted again; elsewhere a processor may fit other bytes to the same data."""
    for name, claimed in weights.named(record).items():
        here = made["weights"].get(name)
        if tier == BITWISE or claimed == here:
            yield equal(f"weights.{name}", claimed, here, source)
        else:
            yield told(f"weights.{name}", f"{source}, to other bytes", claimed, here)


def _of_first(record: Record, evidence: Evidence | None, made: Made) -> Iterator[Verdict]:
    """Say of each metric of several trainings what the first one, made again, tells of it."""
    for key, metric in record["scores"]["metrics"].items():
        kept = evidence is not None and key in evidence.figures
        if not kept or made.evidence is None or key not in made.evidence.figures:
            reason = "of several trainings one is here, and no figures of each to compare it by"
            yield unknown(f"metrics.{key}", reason, metric["value"])


def _each_item(
    record: Record, evidence: Evidence | None, made: Made, bounds: dict[str, float]
) -> Iterator[Verdict]:
    if evidence is None:
        return
    if made.evidence is None:
        yield unknown("evidence", "the scorer hands on no figures of each item")
        return
    yield from compare_evidence(record, evidence, made.evidence, bounds)
    for key in TRACK[record["track"]].ranked_by:
        if key in evidence.figures and key not in made.evidence.figures:
            yield unknown(f"evidence.{key}.each", "not made here")


def _within(record: Record, made: dict[str, Any]) -> Iterator[Verdict]:
    """Say whether each metric that ranks lies in the record's interval; others are told."""
    for key, claimed in record["scores"]["metrics"].items():
        here, subject = made["metrics"].get(key), f"reproduced.{key}"
        if here is None or here["value"] is None or claimed["low"] is None:
            say = unknown if key in TRACK[record["track"]].ranked_by else told
            yield say(subject, "no interval, or not made here", claimed["value"])
            continue
        both = claimed["value"], here["value"]
        inside = claimed["low"] <= here["value"] <= claimed["high"]
        interval = f"95 % interval {claimed['low']:.6g} to {claimed['high']:.6g}"
        if key in TRACK[record["track"]].ranked_by:
            say = holds if inside else fails
            yield say(subject, f"in its {interval}", *both)
        else:
            where = "inside" if inside else "outside"
            yield told(subject, f"does not rank: {where} its {interval}", *both)


def find_records(results: Path, names: list[str], board: str | None) -> list[Path]:
    """Return the records of some names, NAME or TRACK/NAME; all of them if no name is given."""
    paths = [p for p in sorted(results.glob(f"{board or '*'}/*/*.json")) if p.parts[-2] in TRACK]
    if not paths:
        raise RacinesError(f"{results}: no results of {board or 'any board'}")
    called = {path: {path.stem, f"{path.parent.name}/{path.stem}"} for path in paths}
    for name in names:
        if not any(name in known for known in called.values()):
            known = ", ".join(sorted({path.stem for path in paths}))
            raise RacinesError(f"{name!r}: no such result; those there: {known}")
    return [path for path in paths if not names or called[path] & set(names)]
