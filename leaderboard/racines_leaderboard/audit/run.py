"""The audit of one record: checks without scoring, then its numbers recomputed."""

import json
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.audit import claims, ground, metrics, weights
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.numbers import agreement, compare_numbers
from racines_leaderboard.audit.roads import find_road
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
from racines_leaderboard.records.tracks import TRACK, Track


def audit(path: Path, bench: Bench, quick: bool = False) -> Report:
    """Audit the record in a file.

    Args:
        path: `<results>/<board>/<track>/<name>.json`.
        bench: Its board.
        quick: Recompute no number.
    """
    track = TRACK[path.parent.name]
    try:
        record = read_record(path, bench.board, track)
    except RacinesError as error:
        verdicts = (fails("record", str(error)),)
        return Report(bench.board, track.name, path.stem, "", verdicts)
    verdicts = [holds("record", "fits its schema, and stands where it says")]
    verdicts += check(record, bench, peers(path, bench, track))
    how: dict[str, Any] = {}
    if quick:
        verdicts += [
            Verdict(f"metrics.{key}", SKIPPED, "--quick recomputes no number", metric["value"])
            for key, metric in record["scores"]["metrics"].items()
        ]
    else:
        numbers, how = recomputed(record, bench)
        settled = {each.subject for each in numbers}
        verdicts = [each for each in verdicts if each.subject not in settled] + numbers
    return Report(bench.board, track.name, record["name"], record["tier"], tuple(verdicts), how)


def check(record: Record, bench: Bench, others: list[Record]) -> list[Verdict]:
    """Return the verdicts that need no scoring."""
    verdicts = claims.seal(record) + claims.submission(record, bench) + claims.code(record)
    verdicts += claims.environment(record) + claims.scores_file(record, bench)
    if record["track"] == "generators":
        verdicts += ground.dataset(record, bench) + ground.drawing_seeds(record, bench)
    else:
        verdicts += ground.task(record, bench)
    verdicts += ground.judges(record, bench, others)
    verdicts += weights.check_weights(record, bench) + weights.check_content(record, bench)
    return verdicts + metrics.check_metrics(record, bench)


def peers(path: Path, bench: Bench, track: Track) -> list[Record]:
    """Return the other records of a track, without those that are damaged."""
    records = []
    for other in sorted(path.parent.glob("*.json")):
        if other != path:
            try:
                records.append(read_record(other, bench.board, track))
            except RacinesError:
                continue
    return records


def recomputed(record: Record, bench: Bench) -> tuple[list[Verdict], dict[str, Any]]:
    """Recompute the numbers of a record; return a verdict a number, and how it was done."""
    road = find_road(record, bench)
    metrics = record["scores"]["metrics"]
    if isinstance(road, str):
        return [unknown(f"metrics.{key}", road, each["value"]) for key, each in metrics.items()], {}
    try:
        made = json.loads(json.dumps(road.score()))
    except RacinesError as error:
        return [fails("metrics", f"made from {road.source}: {error}")], {"road": road.name}
    tier = agreement(record, made, road.name)
    verdicts = compare_numbers(record, made, tier)
    if road.name == "fitted":
        verdicts += [
            equal(f"weights.{name}", sha256, made["weights"].get(name), road.source)
            for name, sha256 in weights.named(record).items()
        ]
    how = {"road": road.name, "agreement": tier, "from": road.source}
    return verdicts, how | {"environment": made["environment"]}


def find_records(results: Path, names: list[str], board: str | None) -> list[Path]:
    """Return the records of some names, NAME or TRACK/NAME; all of them if no name is given.

    Raises:
        RacinesError: a board without results, or a name that no board has.
    """
    paths = [p for p in sorted(results.glob(f"{board or '*'}/*/*.json")) if p.parts[-2] in TRACK]
    if not paths:
        raise RacinesError(f"{results}: no results of {board or 'any board'}")
    for name in names:
        if not any(name in (p.stem, f"{p.parent.name}/{p.stem}") for p in paths):
            known = ", ".join(sorted({p.stem for p in paths}))
            raise RacinesError(f"{name!r}: no such result; those there: {known}")
    wanted = set(names)
    return [p for p in paths if not wanted or {p.stem, f"{p.parent.name}/{p.stem}"} & wanted]
