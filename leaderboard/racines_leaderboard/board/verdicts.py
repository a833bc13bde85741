"""What the last audit said of a board's records, shown beside each: `results/<board>/audit.json`.

A verdict names the record that it is of by the digest of what that says, so none is shown of
another one that was put in its place.
"""

import json
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.records.schema import seal_of

FILE = "audit.json"
Record = dict[str, Any]


def verdict_of(record: Record) -> str:
    """Return what an audit said of a record that was read with its board; empty where none did."""
    return record.get("verdict", "")


def with_verdict(record: Record, told: dict[str, Any]) -> Record:
    """Add to a record the verdict that is told of it, as `verdict`."""
    said = told.get(f"{record['track']}/{record['name']}")
    if said is None or said["record"] != seal_of(record):
        return record
    return record | {"verdict": said["verdict"]}


def read_verdicts(results: Path, board: str) -> dict[str, Any]:
    """Return what audits said of a board by track/name; nothing where there is no such file.

    Raises:
        RacinesError: a damaged file.
    """
    path = results / board / FILE
    if not path.is_file():
        return {}
    try:
        told = json.loads(path.read_text())["verdicts"]
        for key, said in told.items():
            if not all(isinstance(said[field], str) for field in ("verdict", "record")):
                raise RacinesError(f"{path}: verdicts.{key}: no verdict of a record: audit again")
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        raise RacinesError(f"{path}: not a file of verdicts: {error!r}; audit again") from error
    return told
