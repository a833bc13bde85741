"""Robustness on a board: what a report that was handed in with a submission says of one row.

A report is an artefact of the submission, `kind: robustness`, one a task; the record names it by
its sha256, as all artefacts. What it says of a row lies in `results/<board>/robustness/<row>.json`.
It is the submitter's own run on validation patients, shown in a column of its own, and ranks
nothing.
"""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.records.ranges import check_possible
from racines_leaderboard.records.schema import read_json

FOLDER = "robustness"
KIND = "robustness"
"""Of the artefact."""
PREFIX = "disturbed_"
"""Begins the keys of metrics that a robustness report gives."""
METRIC = f"{PREFIX}found"
Record = dict[str, Any]


def with_robustness(records: list[Record], folder: Path) -> list[Record]:
    """Add to each record what its robustness report says, as `robustness`.

    One of a report that the record's submission does not name, or of other weights or another world
    than its scores, is left out, and `robustness_stale` says so.

    Raises:
        RacinesError: a damaged file, or one in another's place.
    """
    return [_extended(record, folder / f"{record['name']}.json") for record in records]


def _extended(record: Record, path: Path) -> Record:
    if not path.is_file():
        return record
    row = read_json(path, "robustness-record")
    for key, value in (("agent", record["name"]), ("board", record["board"])):
        if row[key] != value:
            raise RacinesError(f"{path}: {key}: {row[key]!r}, expected {value!r} by its place")
    check_possible(row, str(path))
    return record | ({"robustness_stale": True} if is_stale(row, record) else {"robustness": row})


def is_stale(row: Record, record: Record) -> bool:
    """Return whether what a board keeps of a report belongs to another record than this one."""
    handed_in = row["report"] in {each["sha256"] for each in reports_of(record)}
    same_task = row["task"]["view"] == record["scores"]["task"]["view"]
    return not (handed_in and same_task) or apart(row, record["scores"]) is not None


def reports_of(record: Record) -> list[dict[str, Any]]:
    """Return the robustness reports that a record's submission names."""
    document = record["submission"] or {}
    return [each for each in document.get("artefacts", ()) if each["kind"] == KIND]


def hashes_of(scores: dict[str, Any]) -> list[str]:
    """Return the sha256 of all weights that scores, or a report, rest on, in order."""
    weights = scores["weights"] or {}
    return sorted(set(weights.get("files", weights).values()))


def apart(row: dict[str, Any], scores: dict[str, Any]) -> str | None:
    """Say in what a row differs from scores that it would stand beside, or None."""
    if row["weights"] != hashes_of(scores):
        return "of other weights"
    if row["phantom"]["recipe_digest"] != scores["phantom"]["recipe_digest"]:
        return "of another world of patients"
    return None
