"""The audit of one record: checks without scoring, then its numbers recomputed or trained anew.

Another training ends elsewhere, but for the same machine. So a metric that was trained again holds
if the new one lies within the old one's 95 % interval. Where all metrics that rank hold, the
record's tier becomes `reproduced`, and what came out is kept in it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.audit import claims, weights
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.numbers import agreement, check_metrics, compare_numbers
from racines_leaderboard.audit.roads import find_road, score_agent, score_fitted
from racines_leaderboard.audit.verdicts import (
    SKIPPED,
    Report,
    Verdict,
    equal,
    fails,
    holds,
    unknown,
)
from racines_leaderboard.board.collect import Record, read_record
from racines_leaderboard.records.schema import sealed, write_record
from racines_leaderboard.records.tracks import TRACK


def audit(path: Path, bench: Bench, quick: bool = False) -> Report:
    """Audit a record, `<results>/<board>/<track>/<name>.json`; `quick` recomputes no number."""
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    verdicts = [holds("record", "fits its schema, and stands where it says")]
    verdicts += _check(path, record, bench)
    how: dict[str, Any] = {}
    if quick:
        verdicts += [
            Verdict(f"metrics.{key}", SKIPPED, "--quick recomputes no number", metric["value"])
            for key, metric in record["scores"]["metrics"].items()
        ]
    else:
        numbers, how = _recomputed(record, bench)
        settled = {each.subject for each in numbers}
        verdicts = [each for each in verdicts if each.subject not in settled] + numbers
    return _report(record, verdicts, how)


def retrain(path: Path, bench: Bench, into: Path) -> Report:
    """Audit a record by training its system again; write the tier if all that ranks holds.

    The runs are kept in the folder `into`; one that was killed goes on.
    """
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    verdicts = list(_check(path, record, bench))
    not_merged = "its code is not merged: only its artefacts can be scored again"
    if reason := not_merged if weights.submitted(record) else bench.lacks_for(record):
        return _report(record, [*verdicts, unknown("reproduced", reason)], {})
    folder = into / bench.board / record["track"] / record["name"]
    if record["track"] == "generators":
        scores = score_fitted(record, bench, folder)
    else:
        scores = score_agent(record, bench, folder, train=True)
    made = json.loads(json.dumps(scores))
    how = {"road": "trained again", "agreement": "interval", "from": "another training"}
    report = _report(record, [*verdicts, *_within(record, made)], how)
    if report.holds:
        keys = ("seeds", "metrics", "weights", "code", "environment")
        earned = {"tier": "reproduced", "reproduced": {key: made[key] for key in keys}}
        write_record(path, sealed(record | earned))
    return report


def _read(path: Path, bench: Bench) -> Record | Report:
    """Return a record, or the report that it is damaged or belongs elsewhere."""
    track = TRACK[path.parent.name]
    try:
        return read_record(path, bench.board, track)
    except RacinesError as error:
        return Report(bench.board, track.name, path.stem, "", (fails("record", str(error)),))


def _report(record: Record, verdicts: list[Verdict], how: dict[str, Any]) -> Report:
    track, name, tier = (record[key] for key in ("track", "name", "tier"))
    return Report(record["board"], track, name, tier, tuple(verdicts), how)


def _check(path: Path, record: Record, bench: Bench) -> Iterator[Verdict]:
    """Give the verdicts that need no scoring; the other records of the track have a say."""
    yield from claims.check_claims(record, bench)
    if record["track"] == "generators":
        yield from claims.dataset(record, bench)
        yield from claims.drawing_seeds(record, bench)
    else:
        yield from claims.task(record, bench)
    others = [_read(other, bench) for other in sorted(path.parent.glob("*.json")) if other != path]
    peers = [other for other in others if not isinstance(other, Report)]
    yield from claims.judges(record, bench, peers)
    yield from weights.check_weights(record, bench)
    yield from weights.check_content(record, bench)
    yield from check_metrics(record, bench)


def _recomputed(record: Record, bench: Bench) -> tuple[list[Verdict], dict[str, Any]]:
    """Recompute the numbers of a record; return a verdict a number, and how it was done."""
    road = find_road(record, bench)
    if isinstance(road, str):
        claimed = record["scores"]["metrics"].items()
        return [unknown(f"metrics.{key}", road, each["value"]) for key, each in claimed], {}
    try:
        made = json.loads(json.dumps(road.score()))
    except RacinesError as error:
        return [fails("metrics", f"made from {road.source}: {error}")], {"road": road.name}
    tier = agreement(record, made, road.name)
    verdicts = list(compare_numbers(record, made, tier))
    if road.name == "fitted":
        verdicts += [
            equal(f"weights.{name}", sha256, made["weights"].get(name), road.source)
            for name, sha256 in weights.named(record).items()
        ]
    how = {"road": road.name, "agreement": tier, "from": road.source}
    return verdicts, how | {"environment": made["environment"]}


def _within(record: Record, made: dict[str, Any]) -> Iterator[Verdict]:
    """Say whether each metric that ranks lies in the record's interval; others are told."""
    for key, claimed in record["scores"]["metrics"].items():
        here, subject = made["metrics"].get(key), f"reproduced.{key}"
        if here is None or here["value"] is None or claimed["low"] is None:
            yield unknown(subject, "no interval, or not made here", claimed["value"])
            continue
        both = claimed["value"], here["value"]
        inside = claimed["low"] <= here["value"] <= claimed["high"]
        interval = f"95 % interval {claimed['low']:.6g} to {claimed['high']:.6g}"
        if key in TRACK[record["track"]].ranked_by:
            say = holds if inside else fails
            yield say(subject, f"in its {interval}", *both)
        else:
            where = "inside" if inside else "outside"
            yield unknown(subject, f"does not rank: {where} its {interval}", *both)


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
