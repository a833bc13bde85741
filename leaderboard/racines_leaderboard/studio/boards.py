"""The boards as HTML: tables with intervals, charts, and where a record comes from."""

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_leaderboard.chart import panel
from racines_leaderboard.collect import boards, read_board
from racines_leaderboard.groups import SHOWN, by_task
from racines_leaderboard.rank import Ranked, Record, rank
from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.inputs import choice, choices
from racines_leaderboard.studio.pictures import drawn, element
from racines_leaderboard.table import Table, ranked_table, reported_table, shown_columns
from racines_leaderboard.tracks import TIERS, TRACKS, Column, Track

ALL = "all"
TRACK_NAMES = tuple(track.name for track in TRACKS)
SIGHT = {"the image": "image", "the pose": "params", "image and pose": "multimodal"}
"""What an agent sees, as the page names it, and as a task does."""
_INTERVAL = re.compile(r"(?P<value>\S+) \((?P<between>.+)\)(?P<n>, n = [\d,]+)?")


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
    shown = (r.record["name"] for group in _groups(results, wanted).values() for r in group)
    return list(dict.fromkeys(shown))


def tables_html(results: Path, wanted: Selection) -> str:
    """Return the tables of a selection, the paper's figures below them."""
    track, parts = _track(wanted), []
    for title, ranking in _groups(results, wanted).items():
        parts.append(table_html(ranked_table(title, track, ranking)))
        if wanted.details and shown_columns(track.details, ranking):
            further = Track(**(vars(track) | {"columns": track.details}))
            detailed = ranked_table(f"{title} · in detail", further, ranking).bare()
            parts.append(table_html(detailed))
    if not parts:
        return '<p class="rc-note">No result fits: choose other filters.</p>'
    return "\n".join([*parts, table_html(reported_table(track), names=False)])


def table_html(table: Table, names: bool = True) -> str:
    """Return a table as HTML; its rows carry their system's name, to be clicked, with `names`."""
    words = {"", "#", "System", "Sees", "Tier"}
    css = [_css(head, words) for head in table.head]
    head = "".join(f'<th class="{c}">{text(h)}</th>' for c, h in zip(css, table.head, strict=True))
    lines = []
    for row in table.rows:
        cells = "".join(
            f'<td class="{c}">{_cell(each)}</td>' for c, each in zip(css, row, strict=True)
        )
        lines.append(f'<tr data-name="{text(row[1])}">' if names else "<tr>")
        lines.append(f"{cells}</tr>")
    notes = "".join(f"<p>{text(note, 2000)}</p>" for note in table.notes)
    return (
        f'<div class="rc-scroll"><table><caption>{text(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
        f'<div class="rc-note">{notes}</div>'
    )


def charts_html(results: Path, wanted: Selection) -> str:
    """Return one chart a figure of a selection: dots with 95 % intervals, best at the top."""
    track = _track(wanted)
    ranking = _once(_groups(results, wanted))
    columns = (*track.columns, *(track.details if wanted.details else ()))
    shown = [column for column in columns if shown_columns((column,), ranking)]
    charts = [element(_chart(column, _Frozen(ranking)), column.title) for column in shown]
    return f'<div class="rc-grid">{"".join(charts)}</div>'


def record_of(results: Path, wanted: Selection, name: Any) -> Record:
    """Return a record that the selection shows.

    Raises:
        RacinesError: it shows none of that name.
    """
    name = choice(name, names(results, wanted), "system")
    return next(r for r in _content(results, wanted.board)[wanted.track] if r["name"] == name)


class _Frozen(tuple[Ranked, ...]):
    """A ranking that a cache finds by its systems and tells from another by all their figures."""

    def __hash__(self) -> int:
        return hash(tuple((ranked.place, ranked.record["name"]) for ranked in self))


@functools.lru_cache(maxsize=256)
def _chart(column: Column, ranking: _Frozen) -> bytes:
    def draw() -> Figure:
        figure = Figure(figsize=(4.2, 0.6 + 0.3 * len(ranking)), layout="constrained")
        axis = figure.subplots()
        panel(axis, column, ranking)
        axis.locator_params(axis="x", nbins=5)
        return figure

    return drawn(draw)


def _groups(results: Path, wanted: Selection) -> dict[str, list[Ranked]]:
    """Rank all results of each task, then leave out what the filters do; places stay."""
    track, shown = _track(wanted), {}
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


def _once(groups: dict[str, list[Ranked]]) -> list[Ranked]:
    first: dict[str, Ranked] = {}
    for ranking in groups.values():
        for ranked in ranking:
            first.setdefault(ranked.record["name"], ranked)
    return list(first.values())


def _track(wanted: Selection) -> Track:
    return next(track for track in TRACKS if track.name == wanted.track)


def _content(results: Path, board: str) -> dict[str, list[Record]]:
    """Read a board, again only after one of its files has changed."""
    files = sorted((results / board).glob("*/*.json"))
    stamps = tuple((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in files)
    return _read(results, board, stamps)


@functools.lru_cache(maxsize=16)
def _read(results: Path, board: str, stamps: Sequence[Any]) -> dict[str, list[Record]]:
    if board not in boards(results):
        raise RacinesError(f"{results}: no board {board!r}")
    return read_board(results, board)


def _css(head: str, words: set[str]) -> str:
    if head == "System":
        return "rc-text rc-name"
    return "rc-text" if head in words else ""


def _cell(content: str) -> str:
    found = _INTERVAL.fullmatch(content)
    if found is None:
        return text(content)
    below = f"{found['between']}{found['n'] or ''}"
    return f'{text(found["value"])}<span class="rc-between">{text(below)}</span>'
