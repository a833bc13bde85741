"""Training again: merged code, by the board's settings; whether its metrics hold.

Another training ends elsewhere, but for the same machine. So a metric holds if the new one lies
within the old one's 95 % interval. Where all metrics that rank hold, the record's tier becomes
`reproduced`, and what came out is kept in it.
"""

import json
from pathlib import Path
from typing import Any

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.roads import fitted, score_agent, score_run
from racines_leaderboard.audit.run import check, peers
from racines_leaderboard.audit.verdicts import Report, Verdict, fails, holds, unknown
from racines_leaderboard.audit.weights import named, submitted
from racines_leaderboard.board.collect import Record, basis_of, read_record
from racines_leaderboard.records.schema import write_record
from racines_leaderboard.records.seal import sealed
from racines_leaderboard.records.tracks import TRACK, Track


def retrain(path: Path, bench: Bench, into: Path) -> Report:
    """Audit a record by training its system again; write the tier if all that ranks holds.

    Args:
        path: The record.
        bench: Its board.
        into: Folder of the runs; one that was killed goes on.
    """
    track = TRACK[path.parent.name]
    try:
        record = read_record(path, bench.board, track)
    except RacinesError as error:
        return Report(bench.board, track.name, path.stem, "", (fails("record", str(error)),))
    verdicts = check(record, bench, peers(path, bench, track))
    reason = _obstacle(record, bench)
    if reason is None:
        folder = into / bench.board / track.name / record["name"]
        made = json.loads(json.dumps(_train(record, bench, folder)))
        verdicts += _within(record, made, track)
    else:
        verdicts.append(unknown("reproduced", reason))
        made = {}
    how = {}
    if made:
        how = {"road": "trained again", "agreement": "interval", "from": "another training"}
    tier = record["tier"]
    report = Report(bench.board, track.name, record["name"], tier, tuple(verdicts), how)
    if made and report.holds:
        _write(path, record, made)
    return report


def _obstacle(record: Record, bench: Bench) -> str | None:
    """Say why a system cannot be trained again."""
    if submitted(record):
        return "its code is not merged: only its artefacts can be scored again"
    if bench.settings is None:
        return f"no settings of board {bench.board} here: give --params"
    if record["track"] == "generators" and bench.data_for(basis_of(record)) is None:
        return f"no dataset of its recipe in {bench.places.data}"
    return None


def _train(record: Record, bench: Bench, folder: Path) -> dict[str, Any]:
    if record["track"] == "generators":
        with fitted(record, bench, folder) as run:
            return score_run(record, bench, run)
    _train_agent(record, bench, folder)
    return score_agent(record, bench, folder)


def _train_agent(record: Record, bench: Bench, folder: Path) -> None:
    from racines_envs.agents import agent_class
    from racines_envs.cli.settings import phantom_config
    from racines_envs.evaluation.agent_specs import find_entry

    if not named(record):
        return
    assert bench.settings is not None
    entry = find_entry(bench.settings, record["name"])
    cls = agent_class(entry.agent)
    config: Any = fill(cls.Config, entry.settings, entry.where)
    cls.train(
        config,
        folder,
        seed=bench.settings.get("seed", 0),
        phantom=phantom_config(bench.settings),
        data=bench.places.data,
        progress=False,
    )


def _within(record: Record, made: dict[str, Any], track: Track) -> list[Verdict]:
    """Return whether each metric that ranks lies in the record's interval; others are told."""
    verdicts = []
    for key, claimed in record["scores"]["metrics"].items():
        here, subject = made["metrics"].get(key), f"reproduced.{key}"
        if here is None or here["value"] is None or claimed["low"] is None:
            verdicts.append(unknown(subject, "no interval, or not made here", claimed["value"]))
            continue
        inside = claimed["low"] <= here["value"] <= claimed["high"]
        reason = f"95 % interval {claimed['low']:.6g} to {claimed['high']:.6g}"
        if key in track.ranked_by:
            say = holds if inside else fails
            verdicts.append(say(subject, f"in its {reason}", claimed["value"], here["value"]))
        else:
            where = "inside" if inside else "outside"
            reason = f"does not rank: {where} its {reason}"
            verdicts.append(unknown(subject, reason, claimed["value"], here["value"]))
    return verdicts


def _write(path: Path, record: Record, made: dict[str, Any]) -> None:
    keys = ("seeds", "metrics", "weights", "code", "environment")
    reproduced = {key: made[key] for key in keys}
    write_record(path, sealed(record | {"tier": "reproduced", "reproduced": reproduced}))
