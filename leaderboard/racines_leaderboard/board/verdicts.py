"""What an audit said of a board's records, shown beside each: `results/<board>/audit.json`.

    {"generators/vae-gan": {"verdict": "holds", "seal": "…"}, "agents/ppo": "not verified"}

With the record's seal a verdict is of that record alone: it is not shown of another one that was
put in its place.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_leaderboard.records.schema import KEY

FILE = "audit.json"
Record = dict[str, Any]


@dataclass(frozen=True)
class Verdicts:
    """Verdicts by track/name, each a text, or a mapping of `verdict` and `seal`."""

    told: dict[str, Any] = field(default_factory=dict)

    def of(self, record: Record) -> str:
        """Return what was said of a record, or an empty text."""
        said = self.told.get(_key(record), "")
        if isinstance(said, str):
            return said
        return said["verdict"] if said.get("seal") == record.get(KEY) else ""


def verdict_of(record: Record) -> str:
    """Return what an audit said of a record that was read with its board; empty where none did."""
    return record.get("verdict", "")


def read_verdicts(results: Path, board: str) -> Verdicts:
    """Read what audits said of a board; nothing where there is no such file.

    Raises:
        RacinesError: a file that is no such mapping.
    """
    path = results / board / FILE
    if not path.is_file():
        return Verdicts()
    try:
        told = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}; audit again") from error
    if not isinstance(told, dict):
        raise RacinesError(f"{path}: expected verdicts by track/name; audit again")
    for key, said in told.items():
        verdict = said.get("verdict") if isinstance(said, dict) else said
        if not isinstance(verdict, str):
            raise RacinesError(f"{path}: {key}: expected a verdict; audit again")
    return Verdicts(told)


def forget_verdicts(results: Path, board: str, records: Iterable[Record]) -> None:
    """Take out what was said of records that are written anew."""
    told, path = read_verdicts(results, board).told, results / board / FILE
    gone = {_key(record) for record in records}
    kept = {key: said for key, said in told.items() if key not in gone}
    if kept != told:
        write_json(path, kept)


def _key(record: Record) -> str:
    return f"{record['track']}/{record['name']}"
