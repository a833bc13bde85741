"""What a visitor selects of the boards, checked and ranked; its tables and charts as HTML."""

import dataclasses
import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.pages import panel
from racines_leaderboard.board.rank import SHOWN, Ranked, Record, by_task, rank
from racines_leaderboard.board.table import Table, ranked_table, reported_table, shown_columns
from racines_leaderboard.records.tracks import TIERS, TRACK, Column, Track, board_tracks
from racines_leaderboard.studio import html
from racines_leaderboard.studio.inputs import choice, choices
from racines_leaderboard.studio.pictures import drawn, element
from racines_leaderboard.studio.shared import Shared

ALL = "all"
TRACK_NAMES = tuple(TRACK)
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


_INTERVAL = re.compile(r"(?P<value>\S+) \((?P<between>.+)\)(?P<n>, n = [\d,]+)?")
_WORDS = ("", "#", "System", "Sees", "Tier")
"""Columns that hold words; the others hold numbers."""
WIDTH, LETTER, LONGEST = 4.2, 0.075, 30
"""Of a chart, and of a letter of its names, inches; and how many letters of a name are shown."""


def tables_html(results: Path, wanted: Selection) -> str:
    """Return the tables of a selection, the paper's figures below them."""
    track, tables = track_of(wanted), []
    for title, ranking in ranked_groups(results, wanted).items():
        tables.append(table_html(ranked_table(title, track, ranking)))
        if wanted.details and shown_columns(track.details, ranking):
            further = dataclasses.replace(track, columns=track.details)
            detailed = ranked_table(f"{title} · in detail", further, ranking).bare()
            tables.append(table_html(detailed))
    if not tables:
        return '<p class="rc-note">No result fits: choose other filters.</p>'
    return "\n".join([*tables, table_html(reported_table(track), names=False)])


def table_html(table: Table, names: bool = True) -> str:
    """Return a table as HTML; its rows carry their system's name, to be clicked, with `names`."""
    css = [_css(head) for head in table.head]
    rows = [[_cell(content) for content in row] for row in table.rows]
    named = [row[1] for row in table.rows] if names else None
    notes = "".join(f"<p>{html.text(note, 2000)}</p>" for note in table.notes)
    return (
        f'<h3 class="rc-title">{html.text(table.title)}</h3>'
        f"{html.table(table.head, rows, css, named)}"
        f'<div class="rc-note">{notes}</div>'
    )


def charts_html(results: Path, wanted: Selection) -> str:
    """Return one chart a figure of a selection: dots with 95 % intervals, best at the top."""
    track = track_of(wanted)
    ranking = _once(ranked_groups(results, wanted))
    columns = (*track.columns, *(track.details if wanted.details else ()))
    metrics = [column for column in columns if column.value is None]  # what a metric is behind
    shown = [column for column in metrics if shown_columns((column,), ranking)]
    charts = [element(_chart(column, _Frozen(ranking)), column.title) for column in shown]
    return f'<div class="rc-grid">{"".join(charts)}</div>'


class _Frozen(tuple[Ranked, ...]):
    """A ranking that a cache finds by its systems and tells from another by all their figures."""

    def __hash__(self) -> int:
        return hash(tuple((ranked.place, ranked.record["name"]) for ranked in self))


_charts: Shared[bytes] = Shared(256)


def _chart(column: Column, ranking: _Frozen) -> bytes:
    def draw() -> Figure:
        height = 0.6 + 0.3 * len(ranking)
        figure = Figure(figsize=(WIDTH, height))
        axis = figure.add_axes((0.3, 0.32 / height, 0.67, 1.0 - 0.6 / height))
        panel(axis, column, ranking)
        names = [_cut(label.get_text()) for label in axis.get_yticklabels()]
        axis.set_yticks(axis.get_yticks(), names)
        left = (0.15 + LETTER * max(map(len, names))) / WIDTH
        axis.set_position((left, 0.32 / height, 0.97 - left, 1.0 - 0.6 / height))
        axis.locator_params(axis="x", nbins=5)
        return figure

    return _charts.get((column, ranking), lambda: drawn(draw))


def _cut(name: str) -> str:
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def _once(groups: dict[str, list[Ranked]]) -> list[Ranked]:
    first: dict[str, Ranked] = {}
    for ranking in groups.values():
        for ranked in ranking:
            first.setdefault(ranked.record["name"], ranked)
    return list(first.values())


def _css(head: str) -> str:
    if head == "System":
        return "rc-text rc-name"
    return "rc-text" if head in _WORDS else ""


def _cell(content: str) -> str:
    ranged = _INTERVAL.fullmatch(content)
    if ranged is None:
        return content
    below = html.text(f"{ranged['between']}{ranged['n'] or ''}")
    return html.Markup(f'{html.text(ranged["value"])}<span class="rc-between">{below}</span>')
