"""What a visitor selects of the boards, checked, ranked and read anew when a file changes."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.groups import SHOWN, by_task
from racines_leaderboard.board.rank import Ranked, Record, rank
from racines_leaderboard.records.tracks import TIERS, TRACKS, Track, board_tracks
from racines_leaderboard.studio.inputs import choice, choices

ALL = "all"
TRACK_NAMES = tuple(track.name for track in TRACKS)
SIGHT = {"the image": "image", "the pose": "params", "image and pose": "multimodal"}
"""What an agent sees, as the page names it, and as a task does."""


@dataclass(frozen=True)
class Selection:
    """What a visitor wants to see of the boards."""

    board: str
    track: str
    view: str = ALL
    sees: str = ALL
    tiers: tuple[str, ...] = TIERS
    details: bool = False


def selected(results: Path, *chosen: Any) -> Selection:
    """Check what a browser sent: board, track, view, sight, tiers, details.

    Raises:
        RacinesError: something that was not offered.
    """
    board, track, view, sees, tiers, details = chosen
    board = choice(board, boards(results), "board")
    track = choice(track, TRACK_NAMES, "track")
    offered = (ALL, *views(results, board, track))
    return Selection(
        board,
        track,
        # A filter that the other board or track does not know is no mistake of the visitor's.
        view if view in offered else ALL,
        choice(sees, (ALL, *SIGHT), "agent sees") if track == "agents" else ALL,
        choices(tiers, TIERS, "tier"),
        details is True,
    )


def views(results: Path, board: str, track: str) -> list[str]:
    """Return the target views of a track's results; none for generators."""
    tasks = (r["scores"].get("task") for r in _content(results, board)[track])
    return sorted({task["view"] for task in tasks if task})


def names(results: Path, wanted: Selection) -> list[str]:
    """Return the systems that a selection shows, best first, each once."""
    shown = (r.record["name"] for group in ranked_groups(results, wanted).values() for r in group)
    return list(dict.fromkeys(shown))


def record_of(results: Path, wanted: Selection, name: Any) -> Record:
    """Return a record that the selection shows.

    Raises:
        RacinesError: it shows none of that name.
    """
    name = choice(name, names(results, wanted), "system")
    return next(r for r in _content(results, wanted.board)[wanted.track] if r["name"] == name)


def ranked_groups(results: Path, wanted: Selection) -> dict[str, list[Ranked]]:
    """Rank all results of each task, then leave out what the filters do; places stay.

    The keys are the titles of the tables.
    """
    track, shown = track_of(wanted), {}
    for task, records in by_task(_content(results, wanted.board)[track.name]).items():
        if not _fits(task, wanted):
            continue
        kept = [r for r in rank(track, records) if r.record["tier"] in wanted.tiers]
        if kept:
            parts = (wanted.board, track.name, task)
            shown[" · ".join(part for part in parts if part)] = kept
    return shown


def _fits(task: str, wanted: Selection) -> bool:
    """Tell whether a task's title, as `SC from the pose, phantom backend`, passes the filters."""
    subject = task.partition(",")[0]
    view = subject.partition(" ")[0]
    sees = wanted.sees == ALL or subject == f"{view}{SHOWN[SIGHT[wanted.sees]]}"
    return sees and wanted.view in (ALL, view)


def track_of(wanted: Selection) -> Track:
    """Return the track of a selection."""
    return next(track for track in board_tracks() if track.name == wanted.track)


def _content(results: Path, board: str) -> dict[str, list[Record]]:
    """Read a board, again only after one of its files has changed."""
    files = sorted((results / board).glob("*/*.json"))
    stamps = tuple((path, path.stat().st_mtime_ns, path.stat().st_size) for path in files)
    return _read(results, board, stamps)


@functools.lru_cache(maxsize=16)
def _read(results: Path, board: str, stamps: Sequence[Any]) -> dict[str, list[Record]]:
    if board not in boards(results):
        raise RacinesError(f"{results}: no board {board!r}")
    return read_board(results, board)
