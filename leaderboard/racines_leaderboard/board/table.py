"""Boards as tables: for the terminal, as Markdown, and as plain data for `--json`."""

import dataclasses
import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from rich.console import Console
from rich.table import Table as RichTable

from racines_data.tables import console_table, escape, markdown_table
from racines_leaderboard.board.groups import by_task, rankings
from racines_leaderboard.board.rank import Ranked, Record, metric_of, rank, tied
from racines_leaderboard.records.tracks import TRACKS, Column, Track, board_tracks

REPORTED = "reported in the paper, on other data"


@dataclass(frozen=True)
class Table:
    """A table ready to be drawn; every cell is text."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    def bare(self) -> "Table":
        """Return the table without its notes, to follow one that has them."""
        return dataclasses.replace(self, notes=())


def board_tables(
    board: str, content: dict[str, list[Record]], details: bool = False
) -> list[Table]:
    """Return the tables of a board: its tracks (agents by task), then the paper's metrics.

    With `details`, each table is followed by one of the further metrics, in the same order.
    """
    tables = []
    for track in board_tracks():
        for task, records in by_task(content[track.name]).items():
            title = " · ".join(part for part in (board, track.name, task) if part)
            ranking = rank(track, records)
            tables.append(ranked_table(title, track, ranking))
            if details and shown_columns(track.details, ranking):
                further = dataclasses.replace(track, columns=track.details)
                tables.append(ranked_table(f"{title} · in detail", further, ranking).bare())
        if content[track.name]:
            tables.append(reported_table(track))
    return tables


def titled_markdown(table: Table) -> str:
    """Return a table as Markdown: a title in bold, the table, its notes."""
    drawn = markdown_table(table.head, table.rows)
    notes = (f"{escape(note)}  " for note in table.notes)
    return "\n".join([f"**{escape(table.title)}**", "", drawn, "", *notes])


def show(table: Table, console: Console) -> None:
    """Draw a table on a terminal; on its side, one column a system, where it is too wide."""
    rows = [table.head, *table.rows]
    drawn = _drawn(table.title, rows)
    free = console.options.update(width=10_000)
    if console.measure(drawn, options=free).maximum > console.width:
        drawn = _drawn(table.title, [*zip(*rows, strict=True)][1:])
    console.print(drawn)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
    console.print()


def _drawn(title: str, rows: Sequence[Sequence[str]]) -> RichTable:
    return console_table(rows[0], (map(_stacked, row) for row in rows[1:]), title, 2, padding=0)


def plain(content: dict[str, list[Record]]) -> dict[str, Any]:
    """Return ranked results as data: by track, in order, each metric with its interval and n."""
    return {
        track.name: [
            {"rank": ranked.place, "name": ranked.record["name"], "tier": ranked.record["tier"]}
            | ({"task": ranked.record["scores"]["task"]} if track.name == "agents" else {})
            | {"metrics": ranked.record["scores"]["metrics"]}
            | ({"expert": ranked.record["expert"]} if "expert" in ranked.record else {})
            for ranked in rankings(track, content[track.name])
        ]
        for track in TRACKS
    }


def _stacked(text: str) -> str:
    """Put the interval and n of a metric under it, so that a wide table fits a terminal."""
    return text.replace(" (", "\n(").replace(" – ", "–").replace(", n = ", "\nn = ")


@functools.cache
def published() -> dict[str, Any]:
    """Return the metrics of the paper."""
    return json.loads((resources.files("racines_leaderboard") / "published.json").read_text())


def cell(record: Record, column: Column, usual_n: int) -> str:
    """Return a metric with its 95 % interval; with its n where that is not the row's."""
    metric = shown_metric(record, column)
    if metric is None:
        return "–"
    text = _number(metric["value"], column)
    if metric["low"] is not None and metric["high"] is not None:
        text += f" ({_number(metric['low'], column)} – {_number(metric['high'], column)})"
    return text if metric["n"] == usual_n else f"{text}, n = {metric['n']:,}"


def ranked_table(title: str, track: Track, ranking: list[Ranked]) -> Table:
    """Return one ranking as a table, with what there is to say of it; `ranking` holds a result."""
    columns = shown_columns(track.columns, ranking)
    rows, shared = [], tied(ranking)
    for ranked in ranking:
        usual = _usual_n(ranked.record, columns)
        cells = [cell(ranked.record, column, usual) for column in columns]
        place = f"{ranked.place or '–'}{'=' if ranked.place in shared else ''}"
        system = (place, ranked.record["name"], *_sees(track, ranked.record))
        rows.append((*system, *cells, f"{usual:,}", ranked.record["tier"]))
    sees = ("Sees",) if track.name == "agents" else ()
    head = ("#", "System", *sees, *(column.title for column in columns), "n", "Tier")
    basis = f"In brackets: 95 % intervals. n: {track.counted}."
    basis = " ".join(filter(None, (basis, _basis(ranking), _ceiling(ranking))))
    notes = (track.rule, basis, _methods(ranking), _experts(ranking))
    return Table(title, head, tuple(rows), tuple(filter(None, notes)))


def shown_metric(record: Record, column: Column) -> dict[str, Any] | None:
    """Return what a column shows of a result, or None where there is nothing."""
    return metric_of(record, column.key) if column.value is None else column.value(record)


def shown_columns(columns: Sequence[Column], ranking: Sequence[Ranked]) -> list[Column]:
    """Return the columns that any of the results fills."""
    return [c for c in columns if any(shown_metric(r.record, c) for r in ranking)]


def _methods(ranking: list[Ranked]) -> str:
    """Say in a few words what each submitted system is."""
    methods = [
        f"{r.record['name']}, {r.record['submission']['method']}"
        for r in ranking
        if r.record["submission"]
    ]
    return f"Systems: {'; '.join(methods)}." if methods else ""


def _experts(ranking: list[Ranked]) -> str:
    """Say what experts agree with, and whose study is left out."""
    notes = []
    if any("expert" in r.record for r in ranking):
        notes.append(
            "Expert: a blinded study of the generator's images, views that agree with the truth of "
            "the pose, and grades that differ from it by at most 1; it does not rank."
        )
    if stale := [r.record["name"] for r in ranking if r.record.get("expert_stale")]:
        notes.append(f"Left out: studies of other weights or data ({', '.join(stale)}).")
    return " ".join(notes)


def _sees(track: Track, record: Record) -> tuple[str, ...]:
    """Return what an agent goes by, in a tuple; a generator looks at nothing."""
    if track.name != "agents":
        return ()
    scores = record["scores"]
    return (scores.get("sees", scores["task"]["observation"]),)  # older records do not tell


def _usual_n(record: Record, columns: list[Column]) -> int:
    counts = [m["n"] for c in columns if (m := shown_metric(record, c))]
    return max(counts, key=counts.count) if counts else 0


def _basis(ranking: list[Ranked]) -> str:
    """Say which data, or which phantom, the results rest on."""
    scores = ranking[0].record["scores"]
    data = scores.get("dataset") or scores.get("phantom")
    if not data:
        return ""
    source = data.get("source", "phantom")
    simulated = " (simulated)" if source == "phantom" else ""
    return f"Data: {source} {data['version']}{simulated}, recipe {data['recipe_digest'][:12]}."


def _ceiling(ranking: list[Ranked]) -> str:
    """Say how right the judges are where the images are the true ones."""
    record, findings = ranking[0].record, []
    if view := metric_of(record, "view_agreement_truth"):
        findings.append(f"the view agrees in {100 * view['value']:.1f} %")
    error = [metric_of(record, f"pose_error_{unit}_truth") for unit in ("mm", "deg")]
    if error[0] and error[1]:
        millimetres, degrees = (each["value"] for each in error if each)
        findings.append(
            f"the pose is read with an error of {millimetres:.1f} mm and {degrees:.1f}°"
        )
    return f"On the true frames {' and '.join(findings)}." if findings else ""


def reported_table(track: Track) -> Table:
    """Return the paper's own metrics of a track."""
    paper = published()
    systems = paper[track.name]
    names = list(dict.fromkeys(name for system in systems for name in system["figures"]))
    rows = tuple(
        ("", system["system"], *(str(system["figures"].get(name, "–")) for name in names))
        for system in systems
    )
    notes = (paper["remark"][track.name], f"Source: {paper['citation']}.")
    return Table(f"{track.name} · {REPORTED}", ("", "System", *names), rows, notes)


def _number(value: float, column: Column) -> str:
    return f"{value * column.scale:.{column.digits}f}"
