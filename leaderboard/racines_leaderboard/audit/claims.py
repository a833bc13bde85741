"""Claims that hold or not by the repository alone: seal, submission, code, the run's own scores."""

import json
import subprocess
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest as digest_of
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, unknown
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.seal import KEY, seal_of
from racines_leaderboard.submissions.document import find_submission

MACHINE = ("torch", "cpu", "threads", "device")
"""What floating point depends on, of an environment."""


def check_claims(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the seal, the submission, the version and commit of the code, and the machine.

    The scores file that a run left is a second copy of its numbers: whoever edits a record has to
    edit it as well.
    """
    code = record["scores"]["code"]
    yield _seal(record)
    yield _submission(record, bench)
    yield equal("code.version", code["version"], version("racines"), "the package here")
    if commit := code.get("commit"):
        yield _commit(commit)
    yield _environment(record)
    folder = bench.places.runs if record["track"] == "generators" else bench.places.agents
    path = folder / "scores" / f"{record['name']}.json"
    if record["tier"] == "self-reported" and path.is_file():
        yield from _scores_file(record, path, bench)


def _seal(record: Record) -> Verdict:
    if KEY not in record:
        return unknown("seal", "the record has no seal: racines audit --seal gives one")
    reason = "the sha256 of the record as it was written; another one means that it was edited"
    return equal("seal", record[KEY], seal_of(record), reason)


def _submission(record: Record, bench: Bench) -> Verdict:
    """Hold the submission in a record against the YAML and the artefacts that lie here."""
    held = record["submission"]
    name = held["name"] if held else record["scores"].get("submission", record["name"])
    try:
        here = find_submission(bench.places.submissions, record["track"], name)
    except RacinesError as error:
        return fails("submission", str(error))
    if held is None and here is None:
        return unknown("submission", f"nobody submitted {name}: it has scores alone")
    if held is None or here is None:
        where = "the record holds none" if held is None else f"none in {bench.places.submissions}"
        return fails("submission", f"of {name}: {where}: collect its scores again")
    reason = "digest of the submission.yaml held in the record, and of the one here"
    if held.get("schema") != here["schema"]:
        # Earlier records hold fewer fields; those that both have must agree.
        shared = sorted(set(held) & set(here))
        held, here = ({key: document[key] for key in shared} for document in (held, here))
        reason = f"an earlier format; the fields of both agree by digest: {', '.join(shared)}"
    return equal("submission", digest_of(held), digest_of(here), reason)


def _commit(commit: str) -> Verdict:
    """Say whether a commit is part of this checkout's past."""
    words = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    try:
        done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return unknown("code.commit", "no git here", commit)
    if done.returncode == 0:
        return holds("code.commit", "this checkout's own, or one before it", commit)
    other = done.returncode == 1
    reason = "a commit of another branch" if other else "no such commit in this checkout"
    return unknown("code.commit", reason, commit)


def _environment(record: Record) -> Verdict:
    from racines_models import provenance

    if others := differing(record["scores"]["environment"], provenance.environment()):
        reason = f"made elsewhere ({', '.join(others)} differ): numbers are held within tolerance"
        return unknown("environment", reason)
    return holds("environment", f"as here: {', '.join(MACHINE)}")


def differing(claimed: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """Return in which of what floating point depends on two environments differ."""
    versions = [machine["python"].split(".")[:2] for machine in (claimed, here)]
    versions_differ = [] if versions[0] == versions[1] else ["python"]
    return versions_differ + [key for key in MACHINE if claimed.get(key) != here.get(key)]


def _scores_file(record: Record, path: Path, bench: Bench) -> Iterator[Verdict]:
    try:
        here = json.loads(path.read_text())
        board = here.get("board") or (here.get("dataset") or {}).get("board")
    except (ValueError, AttributeError) as error:
        yield fails("scores", f"{path}: not readable as JSON: {error}")
        return
    if board in (None, bench.board):
        reason = f"digest of the scores in the record, and of {path}"
        yield equal("scores", digest_of(record["scores"]), digest_of(here), reason)
