"""The boards as HTML: tables with their intervals, and a chart a figure."""

import dataclasses
import re
from pathlib import Path

from matplotlib.figure import Figure

from racines_leaderboard.board.chart import panel
from racines_leaderboard.board.rank import Ranked
from racines_leaderboard.board.table import Table, ranked_table, reported_table, shown_columns
from racines_leaderboard.records.tracks import Column
from racines_leaderboard.studio.boards import Selection, ranked_groups, track_of
from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.pictures import Drawings, drawn, element

_INTERVAL = re.compile(r"(?P<value>\S+) \((?P<between>.+)\)(?P<n>, n = [\d,]+)?")
_WORDS = ("", "#", "System", "Sees", "Tier")
"""Columns that hold words; the others hold numbers."""
WIDTH, LETTER, LONGEST = 4.2, 0.075, 30
"""Of a chart, and of a letter of its names, inches; and how many letters of a name are shown."""


def tables_html(results: Path, wanted: Selection) -> str:
    """Return the tables of a selection, the paper's figures below them."""
    track, parts = track_of(wanted), []
    for title, ranking in ranked_groups(results, wanted).items():
        parts.append(table_html(ranked_table(title, track, ranking)))
        if wanted.details and shown_columns(track.details, ranking):
            further = dataclasses.replace(track, columns=track.details)
            detailed = ranked_table(f"{title} · in detail", further, ranking).bare()
            parts.append(table_html(detailed))
    if not parts:
        return '<p class="rc-note">No result fits: choose other filters.</p>'
    return "\n".join([*parts, table_html(reported_table(track), names=False)])


def table_html(table: Table, names: bool = True) -> str:
    """Return a table as HTML; its rows carry their system's name, to be clicked, with `names`."""
    css = [_css(head) for head in table.head]
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
        f'<h3 class="rc-title">{text(table.title)}</h3><div class="rc-scroll"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
        f'<div class="rc-note">{notes}</div>'
    )


def charts_html(results: Path, wanted: Selection) -> str:
    """Return one chart a figure of a selection: dots with 95 % intervals, best at the top."""
    track = track_of(wanted)
    ranking = _once(ranked_groups(results, wanted))
    columns = (*track.columns, *(track.details if wanted.details else ()))
    drawn = [column for column in columns if column.value is None]  # what a metric is behind
    shown = [column for column in drawn if shown_columns((column,), ranking)]
    charts = [element(_chart(column, _Frozen(ranking)), column.title) for column in shown]
    return f'<div class="rc-grid">{"".join(charts)}</div>'


class _Frozen(tuple[Ranked, ...]):
    """A ranking that a cache finds by its systems and tells from another by all their figures."""

    def __hash__(self) -> int:
        return hash(tuple((ranked.place, ranked.record["name"]) for ranked in self))


_charts: Drawings[bytes] = Drawings(256)


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
    found = _INTERVAL.fullmatch(content)
    if found is None:
        return text(content)
    below = f"{found['between']}{found['n'] or ''}"
    return f'{text(found["value"])}<span class="rc-between">{text(below)}</span>'
