"""What does not fit between public and fresh figures: too near to the truth, a drop, copies.

A flag is a question to the entry's maker, not a verdict. Flags follow from the figures of a file
alone; `flags_of` makes them again and believes no list.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.audit.weights import named
from racines_leaderboard.fresh.rounds import read_history
from racines_leaderboard.records.schema import KEY, read_json, seal_of
from racines_leaderboard.records.tracks import TRACK, Column

SCHEMA = "racines.secret-scores/1"
FOLDER = "secret"
"""Of a board: `secret/round-1/generators/NAME.json`."""
SIDES = ("public", "secret")


def place(results: Path, board: str, number: int, track: str, name: str) -> Path:
    """Return the file of an entry's fresh draws in a round."""
    return results / board / FOLDER / f"round-{number}" / track / f"{name}.json"


def flags_in(document: dict[str, Any]) -> list[str]:
    """Return what is to be said of an entry's fresh draws; nothing if all fits."""
    flags = []
    if document["reason"] is not None:
        flags.append(f"not recomputable in secret: {document['reason']}")
    if nearer := list(_nearer(document)):
        flags.append(f"too good: nearer to the truth than the truth drawn again ({told(nearer)})")
    if drops := list(_drops(document)):
        flags.append(f"sharp drop from public to secret ({told(drops)})")
    copies = document["copies"]
    if copies is not None and copies["low"] is not None and copies["low"] > 0:
        share = f"{100 * copies['value']:.0f} % of its images at fresh poses are of the dataset"
        flags.append(f"lookup: {share}")
    if document["revealed"]:
        flags.append("drawn after the reveal, when the draws were public")
    return flags


def told(parts: list[str]) -> str:
    """Return parts of a flag as one text."""
    return "; ".join(parts)


def _nearer(document: dict[str, Any]) -> Iterator[str]:
    for side in SIDES:
        for name, apart in (document["nearer"][side] or {}).items():
            if apart["low"] is not None and apart["low"] > 0:
                column = _column(document, name)
                yield f"{side} {column.label} by {apart['value']:.{column.digits}f}"


def _drops(document: dict[str, Any]) -> Iterator[str]:
    """Say which figures fall by more than chance and the margin allow.

    Public and fresh items are other items, so the interval of the difference joins those of both
    (MOVER for independent estimates: distances from value to end add in squares).
    """
    for name, margin in document["margins"].items():
        figures = document["figures"].get(name)
        if figures is None or any(figures[side] is None for side in SIDES):
            continue
        public, secret = (figures[side] for side in SIDES)
        if None in (*public.values(), *secret.values()):
            continue
        apart = public["value"] - secret["value"]
        reach = math.hypot(public["value"] - public["low"], secret["high"] - secret["value"])
        if apart - reach > margin:
            column = _column(document, name)
            before, after = (f"{x['value'] * column.scale:.{column.digits}f}"
                             for x in (public, secret))  # fmt: skip
            yield f"{column.label} {before} to {after}"


def _column(document: dict[str, Any], name: str) -> Column:
    return next(each for each in TRACK[document["track"]].columns if each.key == name)


def read_secret_scores(path: Path, results: Path) -> dict[str, Any]:
    """Read the file of an entry's fresh draws, in its place under a board of the results.

    Raises:
        RacinesError: it is damaged, was edited, belongs elsewhere, rests on a round that the board
            never committed to, or its flags are not those that its figures give.
    """
    document = read_json(path, "secret-scores")
    expected = place(
        results, document["board"], document["round"], document["track"], document["name"]
    )
    if expected != path:
        raise RacinesError(f"{path}: belongs in {expected}")
    if document[KEY] != seal_of(document):
        raise RacinesError(f"{path}: seal: it was edited after it was written: draw it again")
    rounds = {each["round"]: each for each in read_history(results, document["board"])}
    known = rounds.get(document["round"])
    if known is None or known["commitment"] != document["commitment"]:
        raise RacinesError(f"{path}: commitment: the board did not commit to it: draw it again")
    if document["flags"] != (wanted := flags_in(document)):
        raise RacinesError(
            f"{path}: flags: {document['flags']}; its figures give {wanted}: draw it again"
        )
    return document


def flags_of(board_folder: Path, track: str, name: str) -> list[str]:
    """Return the flags of an entry's last fresh draws; none where it was not drawn in secret.

    Args:
        board_folder: `results/<board>`.
        track: The name of its track.
        name: The record's.

    Raises:
        RacinesError: a file of fresh draws that cannot be believed (see `read_secret_scores`).
    """
    results, board = board_folder.parent, board_folder.name
    numbers = [each["round"] for each in read_history(results, board)]
    paths = [place(results, board, number, track, name) for number in reversed(numbers)]
    path = next((each for each in paths if each.is_file()), None)
    if path is None:
        return []
    document = read_secret_scores(path, results)
    record = board_folder / track / f"{name}.json"
    if record.is_file() and named(read_json(record, "record")) != document["weights"]:
        return [*document["flags"], "fresh draws are of an earlier file"]
    return document["flags"]


def flag_notes(board_folder: Path, content: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Return a line on each flagged entry of a board, for below its tables; records by track."""
    named = [(track, record["name"]) for track, records in content.items() for record in records]
    flagged = {key: flags for key in named if (flags := flags_of(board_folder, *key))}
    return [f"Flagged, {track}/{name}: {told(each)}." for (track, name), each in flagged.items()]
