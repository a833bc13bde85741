"""The commands that would verify what an audit could not."""

import dataclasses
import re
import shlex
from collections.abc import Iterator

from racines_data.errors import RacinesError
from racines_envs.agents import agent_class
from racines_envs.evaluation.agent_specs import find_entry
from racines_leaderboard.audit import moving, weights
from racines_leaderboard.audit.bench import JUDGES, KINDS, Bench
from racines_leaderboard.audit.verdicts import RETRAINABLE, Report
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.motions import MOVING, TRACKED_MOTION, TURN_MOTION
from racines_leaderboard.records.tracks import (
    HELD_OUT,
    PATIENT_AGENTS,
    PATIENT_GENERATORS,
    TRACK,
    TURN_GENERATORS,
)
from racines_leaderboard.records.verdicts import NOT_VERIFIED
from racines_models.registry import PATIENTS

TRAIN = "racines train"
_TURNS = "racines data import FOLDER --source rotation --set split=gap"
IMPORTS = {
    TURN_GENERATORS.name: _TURNS,
    TURN_MOTION.name: _TURNS,
    TRACKED_MOTION.name: "racines data import FILES --source tracked --set segments=1",
}
"""Commands that read the recordings of a track, which are of nobody's recipe."""
NAMED = ("grader", "pose")
"""Judges whose folder an option names."""


def remedies(record: Record, bench: Bench, report: Report, quick: bool) -> Iterator[str]:
    """Give the commands, in the order in which they are to be run; none where nothing is open."""
    if report.verdict != NOT_VERIFIED:
        return
    audit = f"racines audit {record['track']}/{record['name']} --board {record['board']}"
    if bench.settings is None:
        yield f"{audit} --params FILE  # the settings of board {record['board']}"
        return
    settings = _settings(bench)
    subjects = {each.subject for each in report.open}
    stored = record["track"] in (*HELD_OUT, *MOVING)
    lacking = bench.lacks_for(record)
    data = shlex.quote(str(bench.data))
    if stored and lacking:
        data = shlex.quote(str(bench.places.data.parent / record["board"]))
        build = f"racines data build {settings}"
        yield f"{IMPORTS.get(record['track'], build)} --out {data}"
    other = moving.board_learned_on(record, bench) if record["track"] in MOVING else None
    if other is not None and moving.lacks_to_learn(record, bench):
        yield f"racines data build {_settings(other)} --out {_learned_from(record, other)}"
    absent = _absent_judges(record, subjects)
    for kind, sha256 in absent.items():
        # One that a board is pinned to was published with it: another training is another judge.
        if bench.pinned(record["track"], kind) != sha256:
            yield f"{TRAIN} {kind} {settings} --data {data}"
    if weights.submitted(record) and any(each.startswith("weights.") for each in subjects):
        folder = weights.submission_of(record, bench)
        yield f"racines submit {shlex.quote(str(folder))} --fetch"
    if not quick and not lacking and _unmade(record, subjects, report):
        kind = "agent" if TRACK[record["track"]].steers else "generator"
        kind = "motion" if record["track"] in MOVING else kind
        name = weights.run_called(record)
        on = f" --data {data}"
        if other is not None:
            settings, on = _settings(other), f" --data {_learned_from(record, other)}"
        if record["track"] in (PATIENT_AGENTS.name, PATIENT_GENERATORS.name):
            on = _of_view(record, bench) if kind == "agent" else f" --tier {PATIENTS}"
        yield f"{TRAIN} {kind} {name} {settings}{on}"
    if any(each.startswith("truth.") for each in subjects):
        yield f"racines leaderboard --recompute {record['track']}/{record['name']} --secret"
        return
    anew = {"reproduced", "trainings"} & subjects
    audit = f"{audit} --retrain" if anew and not quick else audit
    named = [kind for kind in absent if kind in NAMED]
    options = "".join(f" --{kind} FOLDER" for kind in named)
    # Of a record that somebody else wrote: a line to copy has what looks like a digest alone.
    hashes = ((kind, absent[kind]) for kind in named if re.fullmatch(r"[0-9a-f]{64}", absent[kind]))
    files = "; ".join(f"{JUDGES[kind]} of sha256 {sha256}" for kind, sha256 in hashes)
    yield f"{audit}{options}  # {files}" if files else f"{audit}{options}"


def _learned_from(record: Record, other: Bench) -> str:
    """Return where the data lie, or would, that an estimator learned from: another board's."""
    sweeps = moving.learned_on(record, other)
    folder = other.places.data.parent / other.board if sweeps is None else sweeps.store.root
    return shlex.quote(str(folder))


def _of_view(record: Record, bench: Bench) -> str:
    """Return the options that train an entry for the view of a record, if it learns one alone."""
    try:
        entry = find_entry(bench.settings or {}, weights.run_called(record))
        config = agent_class(entry.agent).Config
    except RacinesError:  # an agent that is not installed here: what to train is all that is known
        return ""
    if "view" not in {each.name for each in dataclasses.fields(config)}:
        return ""
    return f" --view {record['scores']['task']['view']} --name {shlex.quote(record['name'])}"


def _absent_judges(record: Record, subjects: set[str]) -> dict[str, str]:
    """Return the sha256 of each judge that a record names and nothing here has, by its kind."""
    named = record["scores"].get("extractors", {})
    open_here = (each for each in KINDS if f"extractors.{each}" in subjects)
    return {KINDS[each]: str(named[each].get("sha256")) for each in open_here}


def _settings(bench: Bench) -> str:
    """Return the option that names a board's settings."""
    packaged = bench.profile is not None
    return (
        f"--profile {bench.profile}" if packaged else f"--params {shlex.quote(str(bench.params))}"
    )


def _unmade(record: Record, subjects: set[str], report: Report) -> bool:
    """Return whether merged code has to be trained, since no weights of it are here."""
    merged = not weights.submitted(record) and "agreement" not in report.made_again
    judged = not any(subject.startswith("extractors.") for subject in subjects)
    return merged and judged and not report.count(RETRAINABLE) and bool(weights.named(record))
