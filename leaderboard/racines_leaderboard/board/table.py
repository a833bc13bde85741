"""Boards as tables: for the terminal, as Markdown, and as plain data for `--json`."""

import dataclasses
import functools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from rich.console import Console
from rich.table import Table as RichTable

from racines_data.tables import console_table, csv_table, escape, markdown_table
from racines_data.terminal import shown_text
from racines_leaderboard.board.declared import (
    CSV_DECLARED,
    declared,
    declared_cells,
    declared_columns,
    declared_note,
)
from racines_leaderboard.board.rank import (
    SCORE,
    Ranked,
    Record,
    by_task,
    metric_of,
    rank,
    rankings,
    score_metric,
    tied,
    unpinned,
    verdict_of,
)
from racines_leaderboard.records.columns import PERCENT, Column, Track
from racines_leaderboard.records.tracks import TRACKS, board_tracks
from racines_models.statistics import LEVEL

STUDIED = ("expert", "robustness")
"""What studies say of a record beside its scores."""
REPORTED = "reported in the paper, on other data"


@dataclass(frozen=True)
class Table:
    """A table ready to be drawn; every cell is text."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


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
            tables += ranked_tables(title, track, rank(track, records), details)
        if content[track.name]:
            tables += reported_tables(track)
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
    if console.measure(drawn, options=console.options.update(width=10_000)).maximum > console.width:
        drawn = _drawn(table.title, [*zip(*rows, strict=True)][1:])
    console.print(drawn)
    for note in table.notes:
        console.print(shown_text(note), style="dim")
    console.print()


def _drawn(title: str, rows: Sequence[Sequence[str]]) -> RichTable:
    """Return a table, the interval and n of a metric under it, so that a wide one fits."""
    stacked = (
        [cell.replace(" (", "\n(").replace(" – ", "–").replace(", n = ", "\nn = ") for cell in row]
        for row in rows[1:]
    )
    return console_table(rows[0], stacked, title, 2, padding=0)


def plain(content: dict[str, list[Record]]) -> dict[str, Any]:
    """Return ranked results as data: by track, in order, each metric with its interval and n."""
    return {
        track.name: [
            {"rank": ranked.place, "name": ranked.record["name"], "tier": ranked.record["tier"]}
            | {"score": score_metric(ranked.record), "unplaced": ranked.standing.why or None}
            | {key: getattr(ranked.standing, key) for key in ("trainings", "units")}
            | {"verdict": verdict_of(ranked.record) or None}
            | ({"task": ranked.record["scores"]["task"]} if track.steers else {})
            | ({"training": told} if (told := declared(ranked.record)) else {})
            | {"metrics": ranked.record["scores"]["metrics"]}
            | {key: ranked.record[key] for key in STUDIED if key in ranked.record}
            for ranked in rankings(track, content[track.name])
        ]
        for track in TRACKS
    }


_OF_METRIC = ("value", "low", "high", "n")
_STANDING = ("unplaced", "trainings", "units", "verdict", "level")
CSV_HEAD = (
    *("board", "track", "task", "place", "name", "tier", "method", "figure"),
    *_OF_METRIC,
    *_STANDING,
    *CSV_DECLARED,
)


def board_csv(contents: dict[str, dict[str, list[Record]]]) -> str:
    """Return boards by name as one CSV file, a line a figure of a result, in the order of scores.

    The score, where there is one, is the first of its figures.
    """
    lines = []
    for board, content in contents.items():
        for track in TRACKS:
            for task, records in by_task(content[track.name]).items():
                for ranked in rank(track, records):
                    record, standing, place = ranked.record, ranked.standing, ranked.place
                    method = (record["submission"] or {}).get("method")
                    about = (board, track.name, task, place, record["name"], record["tier"], method)
                    stands = (standing.why or None, standing.trainings, standing.units)
                    score, training = score_metric(record), declared_cells(record)
                    figures = {"score": score} if score is not None else {}
                    lines += [
                        (*about, figure, *(metric.get(key) for key in _OF_METRIC), *stands,
                         verdict_of(record) or None, level_of(metric), *training)
                        for figure, metric in (figures | record["scores"]["metrics"]).items()
                    ]  # fmt: skip
    return csv_table(CSV_HEAD, lines)


@functools.cache
def published() -> dict[str, Any]:
    """Return the metrics of the paper."""
    return json.loads(
        (resources.files("racines_leaderboard") / "published.json").read_text(encoding="utf-8")
    )


def level_of(metric: dict[str, Any]) -> float | None:
    """Return how often intervals like a metric's cover, where that is known."""
    return metric.get("settings", {}).get("level")


def _cell(record: Record, column: Column, usual_n: int) -> str:
    """Return a metric with its interval; with its n where that is not the row's."""
    metric = shown_metric(record, column)
    if metric is None:
        return "–"
    text = figure_text(metric, column)
    return text if metric["n"] == usual_n else f"{text}, n = {metric['n']:,}"


def steady(number: float) -> float:
    """Return a number as every processor shows it: the order of a sum moves the last bits.

    A score of -1e-16 on one machine is 0 on another, and neither is -0.
    """
    return round(number, 9) + 0.0


def figure_text(metric: dict[str, Any], column: Column) -> str:
    """Return a metric in the unit shown, its interval, and where that covers less, how much."""
    value, low, high = (
        None if metric[key] is None else f"{steady(metric[key] * column.scale):.{column.digits}f}"
        for key in ("value", "low", "high")
    )
    level = level_of(metric)
    covered = f"; {100 * level:.0f} %" if level is not None and level < LEVEL else ""
    return str(value) if low is None or high is None else f"{value} ({low} – {high}{covered})"


def ranked_tables(
    title: str, track: Track, ranking: list[Ranked], details: bool
) -> Iterator[Table]:
    """Yield one ranking as a table, and with `details` one of the further metrics, if any."""
    yield ranked_table(title, track, ranking)
    if details and shown_columns(track.details, ranking):
        further = dataclasses.replace(track, columns=track.details)
        table = ranked_table(f"{title} · in detail", further, ranking, training=False)
        yield dataclasses.replace(table, notes=())  # it follows one that has them


def ranked_table(title: str, track: Track, ranking: list[Ranked], training: bool = True) -> Table:
    """Return one ranking as a table, with what there is to say of it; `ranking` holds a result.

    With `training`, what its submissions declare of their training stands in it.
    """
    columns = shown_columns((SCORE, *track.columns), ranking)
    agents, shared = track.steers, tied(ranking)
    counted = [(head, key) for head, key in (("Trainings", "trainings"), ("Units", "units"))
               if any(getattr(each.standing, key) for each in ranking)]  # fmt: skip
    judged = any(verdict_of(each.record) for each in ranking)
    records = [each.record for each in ranking]
    told = declared_columns(records) if training else []
    rows = []
    for i, ranked in enumerate(ranking):
        record, standing = ranked.record, ranked.standing
        counts = [m["n"] for c in columns if (m := shown_metric(record, c))]
        usual = max(counts, key=counts.count, default=0)
        system = [place_of(ranked, shared), record["name"]]
        if agents:  # older records do not tell what an agent goes by
            system.append(record["scores"].get("sees", record["scores"]["task"]["observation"]))
        cells = [_cell(record, column, usual) for column in columns]
        cells += [f"{getattr(standing, key) or '–'}" for _, key in counted]
        cells += [column[i] for _, column in told]
        verdict = [verdict_of(record) or "–"] if judged else []
        rows.append((*system, *cells, f"{usual:,}", *verdict, record["tier"]))
    sees, verdict = ("Sees",) if agents else (), ("Verdict",) if judged else ()
    titles = (*(column.title for column in columns), *(head for head, _ in (*counted, *told)))
    head = ("#", "System", *sees, *titles, "n", *verdict, "Tier")
    few = f"{PERCENT} intervals; where such intervals were found to cover less, how much"
    shown = [shown_metric(each.record, column) for each in ranking for column in columns]
    less = any(metric is not None and (level_of(metric) or LEVEL) < LEVEL for metric in shown)
    counts = f"In brackets: {few if less else f'{PERCENT} intervals'}. n: {track.counted}."
    units = f" Units: {track.unit}." if any(key == "units" for _, key in counted) else ""
    basis = " ".join([counts + units, *_basis(records)])
    rule = no_anchors(ranking[0].record) if unpinned(ranking) else track.rule
    notes = tuple(filter(None, (rule, basis, declared_note(records), *_notes(ranking))))
    return Table(title, head, tuple(rows), notes)


def place_of(ranked: Ranked, shared: set[int]) -> str:
    """Return a place, marked where several share it; or why there is none."""
    if ranked.place is None:
        return ranked.standing.why
    return f"{ranked.place}{'=' if ranked.place in shared else ''}"


def no_anchors(record: Record) -> str:
    """Say why nothing is ranked beside a record."""
    board = record.get("board", "BOARD")
    track = "task" if "agent" in record["scores"] else "board"
    pairs = {each.name: " and ".join(each.anchors) for each in TRACKS}
    anchors = pairs.get(record.get("track", ""), "its anchors")
    return (
        f"Nothing is ranked: this {track} has no anchors, rows are in the order of names. "
        f"`racines board pin {board}` pins the board, once {anchors} are on it, scored by the "
        "same judges as the others."
    )


def shown_metric(record: Record, column: Column) -> dict[str, Any] | None:
    """Return what a column shows of a result, or None where there is nothing."""
    return metric_of(record, column.key) if column.value is None else column.value(record)


def shown_columns(columns: Sequence[Column], ranking: Sequence[Ranked]) -> list[Column]:
    """Return the columns that any of the results fills."""
    return [c for c in columns if any(shown_metric(r.record, c) for r in ranking)]


def _notes(ranking: list[Ranked]) -> Iterator[str]:
    """Say what each submitted system is, what experts agree with, whose study is left out."""
    records = [ranked.record for ranked in ranking]
    methods = [f"{r['name']}, {r['submission']['method']}" for r in records if r["submission"]]
    if methods:
        yield f"Systems: {'; '.join(methods)}."
    notes = []
    if any("expert" in record for record in records):
        notes.append(
            "Expert: a blinded study of the generator's images, views that agree with the truth of "
            "the pose, and grades that differ from it by at most 1; it does not rank."
        )
    if disturbed := [each for each in records if "robustness" in each]:
        notes.append(_on_whom(disturbed))
    stale = [r["name"] for r in records if any(r.get(f"{key}_stale") for key in STUDIED)]
    if stale:
        why = "of other weights or data, or no longer handed in"
        notes.append(f"Left out: studies {why} ({', '.join(stale)}).")
    if notes:
        yield " ".join(notes)


def _on_whom(disturbed: list[Record]) -> str:
    """Say what robustness is and on whom it was measured."""
    reports = [each["robustness"] for each in disturbed]
    counts = sorted({each["task"]["start_set"]["patients"] for each in reports})
    things = sorted({len(each["disturbances"]) for each in reports})
    told, wrong = (" or ".join(map(str, each)) for each in (counts, things))
    other = [
        each["name"] for each in disturbed if each["robustness"]["code"] != each["scores"]["code"]
    ]
    apart = f" By other code than the scores: {', '.join(other)}." if other else ""
    return (
        f"Disturbed: found and declared with one thing wrong, the mean over {wrong} disturbances "
        f"at moderate strength, on {told} validation patients and not on the test patients; the "
        f"submitter's own report; it does not rank.{apart}"
    )


def _basis(records: list[Record]) -> Iterator[str]:
    """Say what data the results rest on, and how right the judges are on the true images."""
    judged = (each for each in records if metric_of(each, "view_agreement_truth"))
    record = next(judged, records[0])
    data = record["scores"].get("dataset") or record["scores"].get("phantom")
    if data:
        source = data.get("source", "phantom")
        simulated = " (simulated)" if source == "phantom" else ""
        yield f"Data: {source} {data['version']}{simulated}, recipe {data['recipe_digest'][:12]}."
    findings = []
    if view := metric_of(record, "view_agreement_truth"):
        findings.append(f"the view agrees in {100 * view['value']:.1f} %")
    mm, deg = (metric_of(record, f"pose_error_{unit}_truth") for unit in ("mm", "deg"))
    if mm and deg:
        findings.append(
            f"the pose is read with an error of {mm['value']:.1f} mm and {deg['value']:.1f}°"
        )
    if findings:
        yield f"On the true frames {' and '.join(findings)}."


def reported_tables(track: Track) -> list[Table]:
    """Return the paper's own metrics of a track; none of one that it does not have."""
    paper = published()
    systems = paper.get(track.name, ())
    names = list(dict.fromkeys(name for system in systems for name in system["figures"]))
    rows = tuple(
        ("", system["system"], *(str(system["figures"].get(name, "–")) for name in names))
        for system in systems
    )
    if not rows:
        return []
    notes = (paper["remark"][track.name], f"Source: {paper['citation']}.")
    return [Table(f"{track.name} · {REPORTED}", ("", "System", *names), rows, notes)]
