"""Claims that hold or not by the repository alone: seal, submission, code, the run's own scores."""

import hashlib
import json
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

from racines_data.digest import canonical_json
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, unknown
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.seal import KEY, seal_of
from racines_leaderboard.submissions.document import find_submission

MACHINE = ("torch", "cpu", "threads", "device")
"""What floating point depends on, of an environment."""


def seal(record: Record) -> list[Verdict]:
    """Check that a record says what it said when it was written."""
    if KEY not in record:
        reason = "the record has no seal: racines audit --seal gives one"
        return [unknown("seal", reason)]
    reason = "the sha256 of the record as it was written; another one means that it was edited"
    return [equal("seal", record[KEY], seal_of(record), reason)]


def submission(record: Record, bench: Bench) -> list[Verdict]:
    """Check the submission in a record against the YAML and the artefacts that lie here."""
    held, scores = record["submission"], record["scores"]
    name = held["name"] if held else scores.get("submission", record["name"])
    try:
        here = find_submission(bench.places.submissions, record["track"], name)
    except RacinesError as error:
        return [fails("submission", str(error))]
    if held is None or here is None:
        if held is here:
            return [unknown("submission", f"nobody submitted {name}: it has scores alone")]
        where = "the record holds none" if held is None else f"none in {bench.places.submissions}"
        return [fails("submission", f"of {name}: {where}: collect its scores again")]
    if held.get("schema") != here["schema"]:
        # Earlier records hold fewer fields; those that both have must agree.
        shared = sorted(set(held) & set(here))
        held, here = ({key: document[key] for key in shared} for document in (held, here))
        reason = f"an earlier format; the fields of both agree by digest: {', '.join(shared)}"
    else:
        reason = "digest of the submission.yaml held in the record, and of the one here"
    return [equal("submission", _digest(held), _digest(here), reason)]


def _digest(document: dict[str, Any]) -> str:
    return hashlib.sha256(canonical_json(document).encode()).hexdigest()


def code(record: Record) -> list[Verdict]:
    """Check the version of the code, and whether its commit is part of this checkout's past."""
    claimed = record["scores"]["code"]
    verdicts = [equal("code.version", claimed["version"], version("racines"), "the package here")]
    if commit := claimed.get("commit"):
        verdicts.append(_commit(commit))
    return verdicts


def _commit(commit: str) -> Verdict:
    subject, folder = "code.commit", Path(__file__).parent
    words = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return unknown(subject, "no git here", commit)
    if done.returncode == 0:
        return holds(subject, "this checkout's own, or one before it", commit)
    if done.returncode == 1:
        return unknown(subject, "a commit of another branch", commit)
    return unknown(subject, "no such commit in this checkout", commit)


def environment(record: Record) -> list[Verdict]:
    """Say whether the scores were made on a machine like this one."""
    from racines_models import provenance

    claimed = record["scores"]["environment"]
    if others := differing(claimed, provenance.environment()):
        reason = f"made elsewhere ({', '.join(others)} differ): numbers are held within tolerance"
        return [unknown("environment", reason)]
    return [holds("environment", f"as here: {', '.join(MACHINE)}")]


def differing(claimed: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """Return in which of what floating point depends on two environments differ."""
    versions = [machine["python"].split(".")[:2] for machine in (claimed, here)]
    versions_differ = [] if versions[0] == versions[1] else ["python"]
    return versions_differ + [key for key in MACHINE if claimed.get(key) != here.get(key)]


def scores_file(record: Record, bench: Bench) -> list[Verdict]:
    """Check a record that was collected against the scores file that its run left, if it is here.

    The file is a second copy of the numbers: whoever edits a record has to edit it as well.
    """
    folder = bench.places.runs if record["track"] == "generators" else bench.places.agents
    path = folder / "scores" / f"{record['name']}.json"
    if record["tier"] != "self-reported" or not path.is_file():
        return []
    try:
        here = json.loads(path.read_text())
        board = here.get("board") or (here.get("dataset") or {}).get("board")
    except (ValueError, AttributeError) as error:
        return [fails("scores", f"{path}: not readable as JSON: {error}")]
    if board not in (None, bench.board):
        return []
    reason = f"digest of the scores in the record, and of {path}"
    return [equal("scores", _digest(record["scores"]), _digest(here), reason)]
