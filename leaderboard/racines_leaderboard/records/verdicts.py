"""What the last audit said of each record of a board, kept in `audit.json` beside its tracks.

A verdict is about the record as it was then, by the digest of all that it says. Of a record that
says anything else now, even if it is sealed again, there is no verdict.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked, write_atomic
from racines_leaderboard.records.schema import check, read_json, seal_of

HOLDS, DOES_NOT_HOLD, NOT_VERIFIED = "holds", "does not hold", "not verified"
EXITS = {HOLDS: 0, NOT_VERIFIED: 3, DOES_NOT_HOLD: 1}
"""What `racines audit` exits with; of several records, 1 wins over 3 and 3 over 0."""
FILE = "audit.json"
SCHEMA = "racines.verdicts/1"


@dataclass(frozen=True)
class Audited:
    """What an audit said of one record."""

    verdict: str
    """`holds`, `does not hold` or `not verified`."""
    record: str
    """The sha256 of what the record said, as `seal_of` gives it."""
    tier: str
    """The tier that the evidence gave it."""
    agreement: str | None = None
    """How near the recomputed numbers came: `bitwise`, `tolerance`, …; None: none recomputed."""
    retrainable: int = 0
    """Trainings beyond the first that are not here, and can be made anew."""


def verdict_of(record: dict[str, Any], results: Path) -> Audited | None:
    """Return what the last audit of its board said of a record; None if of this one it said none.

    Raises:
        RacinesError: the board's `audit.json` is damaged.
    """
    return among(record, read_verdicts(results / record["board"]))


def among(record: dict[str, Any], kept: Mapping[str, Audited]) -> Audited | None:
    """Return what is kept of a record, if it says what it said then."""
    found = kept.get(f"{record['track']}/{record['name']}")
    return found if found is not None and found.record == seal_of(record) else None


def read_verdicts(board: Path) -> dict[str, Audited]:
    """Return what is kept in a board's folder by `track/name`; nothing where there is no file.

    Raises:
        RacinesError: a damaged file.
    """
    path = board / FILE
    if not path.is_file():
        return {}
    told = read_json(path, "verdicts")["verdicts"]
    return {name: Audited(**each) for name, each in told.items()}


def keep_verdicts(board: Path, said: Mapping[str, Audited]) -> Path:
    """Write verdicts by `track/name` beside those kept; those of records no longer there go.

    Raises:
        RacinesError: a damaged file, or no such board.
    """
    if not board.is_dir():
        raise RacinesError(f"{board}: no such board")
    path = board / FILE
    with locked(board.parent):
        kept = read_verdicts(board) | dict(said)
        there = {name: kept[name] for name in sorted(kept) if (board / f"{name}.json").is_file()}
        content = {
            "schema": SCHEMA,
            "verdicts": {name: asdict(each) for name, each in there.items()},
        }
        check(content, "verdicts", str(path))
        write_atomic(path, json.dumps(content, indent=2) + "\n")
    return path
