"""What a visitor selects of the boards, checked and ranked, as HTML: tables, charts, provenance.

What was not offered raises a `RacinesError`.
"""

import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from racines_leaderboard.board.about import about
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.pages import panel
from racines_leaderboard.board.rank import SCORE, SHOWN, Ranked, Record, by_task, rank, verdict_of
from racines_leaderboard.board.table import Table, ranked_tables, reported_tables, shown_columns
from racines_leaderboard.records.columns import PERCENT, Column, Track
from racines_leaderboard.records.tracks import TIERS, TRACK, board_tracks
from racines_leaderboard.studio import html
from racines_leaderboard.studio.html import cut, drawn, element, link, note, text
from racines_leaderboard.studio.inputs import choice, choices
from racines_leaderboard.studio.parts import Shared

ALL = "all"
TRACK_NAMES = tuple(TRACK)
SIGHT = {"the image": "image", "the pose": "params", "image and pose": "multimodal"}
"""What an agent sees, as the page names it, and as a task does."""
WIDTH, LETTER, LONGEST = 4.2, 0.075, 30
"""Of a chart, and of a letter of its names, inches; and how many letters of a name are shown."""
SHORT = 16
"""Characters of a digest that are shown."""
_contents: Shared[dict[str, list[Record]]] = Shared(16)
_charts: Shared[bytes] = Shared(256)
_INTERVAL = re.compile(r"(?P<value>\S+) \((?P<between>.+)\)(?P<n>, n = [\d,]+)?")
_WORDS = ("", "#", "Sees", "Verdict", "Tier")
_CSS = dict.fromkeys(_WORDS, "rc-text") | {"System": "rc-text rc-name"}
"""Of the columns that hold words; the others hold numbers."""


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
    """Check what a browser sent: board, track, view, sight, tiers, details."""
    board, track, view, sees, tiers, details = chosen
    board = choice(board, boards(results), "board")
    track = choice(track, TRACK_NAMES, "track")
    # A filter that the other board or track does not know is no mistake of the visitor's.
    view = view if view in views(results, board, track) else ALL
    sees = choice(sees, (ALL, *SIGHT), "agent sees") if TRACK[track].steers else ALL
    return Selection(board, track, view, sees, choices(tiers, TIERS, "tier"), details is True)


def held(results: Path, board: str) -> list[str]:
    """Return the tracks of which a board has a result; the page offers no board without any."""
    return [name for name, records in _content(results, board).items() if records]


def track_held(results: Path, board: str, chosen: str = "") -> str:
    """Return the chosen track where a board has it, else the first that it has."""
    there = held(results, board)
    return chosen if chosen in there else there[0]


def views(results: Path, board: str, track: str) -> list[str]:
    """Return the target views of a track's results; none for generators."""
    tasks = (r["scores"].get("task") for r in _content(results, board)[track])
    return sorted({task["view"] for task in tasks if task})


def names(results: Path, wanted: Selection) -> list[str]:
    """Return the systems that a selection shows, best first, each once."""
    return [ranked.record["name"] for ranked in _once(ranked_groups(results, wanted))]


def record_of(results: Path, wanted: Selection, name: Any) -> Record:
    """Return a record that the selection shows."""
    name = choice(name, names(results, wanted), "system")
    return next(r for r in _content(results, wanted.board)[wanted.track] if r["name"] == name)


def ranked_groups(results: Path, wanted: Selection) -> dict[str, list[Ranked]]:
    """Rank all results of each task, then leave out what the filters do; places stay.

    The keys are the titles of the tables.
    """
    track, shown = track_of(wanted), {}
    for task, records in by_task(_content(results, wanted.board)[track.name]).items():
        kept = [r for r in rank(track, records) if r.record["tier"] in wanted.tiers]
        if kept and _fits(task, wanted):
            shown[" · ".join(filter(None, (wanted.board, track.name, task)))] = kept
    return shown


def _fits(task: str, wanted: Selection) -> bool:
    """Tell whether a task's title, as `SC from the pose, phantom backend`, passes the filters."""
    subject = task.partition(",")[0]
    view = subject.partition(" ")[0]
    sees = wanted.sees == ALL or subject == f"{view}{SHOWN[SIGHT[wanted.sees]]}"
    return sees and wanted.view in (ALL, view)


def _once(groups: dict[str, list[Ranked]]) -> list[Ranked]:
    """Return each system of all groups where it stands first."""
    first: dict[str, Ranked] = {}
    for ranked in sum(groups.values(), []):
        first.setdefault(ranked.record["name"], ranked)
    return list(first.values())


def track_of(wanted: Selection) -> Track:
    """Return the track of a selection."""
    return next(track for track in board_tracks() if track.name == wanted.track)


def _content(results: Path, board: str) -> dict[str, list[Record]]:
    """Read a board, again only after one of its files has changed."""
    folder = results / board
    found = (folder.glob(pattern) for pattern in ("*.json", "*/*.json", "*/*.parquet"))
    files = sorted(itertools.chain(*found))
    stamps = tuple((path, path.stat().st_mtime_ns, path.stat().st_size) for path in files)
    known = choice(board, boards(results), "board")
    return _contents.get((results, known, stamps), lambda: read_board(results, known))


def tables_html(results: Path, wanted: Selection) -> str:
    """Return the tables of a selection, the paper's figures below them."""
    track, tables = track_of(wanted), []
    for title, ranking in ranked_groups(results, wanted).items():
        tables += map(_table, ranked_tables(title, track, ranking, wanted.details))
    if not tables:
        there = held(results, wanted.board)
        if track.name not in there:
            return note(f"This board has no {track.name}: choose {' or '.join(there)}.")
        return note("No result fits: choose other filters.")
    reported = (_table(each, named=False) for each in reported_tables(track))
    return "\n".join([note(about(wanted.board)), *tables, *reported])


def _table(table: Table, named: bool = True) -> str:
    """Return a table as HTML; its rows carry their system's name, to be clicked, with `named`."""
    placed = slice(0 if named else 1, None)  # what was reported has no places: nothing to head
    css = [_CSS.get(head, "") for head in table.head[placed]]
    rows = [[_cell(content) for content in row[placed]] for row in table.rows]
    systems = [row[1] for row in table.rows] if named else None
    notes = "".join(f"<p>{text(words, 2000)}</p>" for words in table.notes)
    return (
        f'<h2 class="rc-title">{text(table.title)}</h2>'
        f"{html.table(table.head[placed], rows, css, systems)}"
        f'<div class="rc-note">{notes}</div>'
    )


def _cell(content: str) -> str:
    """Put the interval and n of a figure under it."""
    ranged = _INTERVAL.fullmatch(content)
    if ranged is None:
        return content
    below = text(f"{ranged['between']}{ranged['n'] or ''}")
    return html.Markup(f'{text(ranged["value"])}<span class="rc-between">{below}</span>')


def charts_html(results: Path, wanted: Selection) -> str:
    """Return one chart a figure of a selection: dots with intervals, in the tables' order."""
    track = track_of(wanted)
    ranking = _Frozen(_once(ranked_groups(results, wanted)))
    columns = (*track.columns, *(track.details if wanted.details else ()))
    metrics = [column for column in columns if column.value is None]  # what a metric is behind
    shown = shown_columns([SCORE, *metrics], ranking)
    charts = [element(_chart(column, ranking), column.title) for column in shown]
    return f'<div class="rc-grid">{"".join(charts)}</div>'


class _Frozen(tuple[Ranked, ...]):
    """A ranking that a cache finds by its systems and tells from another by all their figures."""

    def __hash__(self) -> int:
        return hash(tuple((ranked.place, ranked.record["name"]) for ranked in self))


def _chart(column: Column, ranking: _Frozen) -> bytes:
    def draw(figure: Figure) -> None:
        axis = figure.add_axes((0.3, bottom, 0.67, high))
        panel(axis, column, ranking)
        names = [cut(label.get_text(), LONGEST) for label in axis.get_yticklabels()]
        axis.set_yticks(axis.get_yticks(), names)
        left = (0.15 + LETTER * max(map(len, names))) / WIDTH
        axis.set_position((left, bottom, 0.97 - left, high))
        axis.locator_params(axis="x", nbins=5)

    height = 0.6 + 0.3 * len(ranking)
    bottom, high = 0.32 / height, 1.0 - 0.6 / height
    return _charts.get((column, ranking), lambda: drawn((WIDTH, height), draw)[0])


def provenance_html(record: Record) -> str:
    """Return who made a result, the data, the code, and the basis of every figure."""
    entries = "".join(f"<dt>{text(k)}</dt><dd>{v}</dd>" for k, v in _facts(record) if v.strip())
    return f'<div class="rc-facts"><dl>{entries}</dl>{_figures(record)}</div>'


def _facts(record: Record) -> list[tuple[str, str]]:
    """Return what there is to know of a record by name, as HTML; empty where it is not known."""
    submission, scores = record["submission"] or {}, record["scores"]
    code = scores.get("code") or {}
    data = scores.get("dataset") or scores.get("phantom") or {}
    source = text(f"{data.get('source', 'phantom')} {data.get('version', '')}")
    digests = {key: data[key] for key in ("digest", "recipe_digest") if data.get(key)}
    task = {k: v for k, v in (scores.get("task") or {}).items() if isinstance(v, str)}
    return [
        ("Board", text(record["board"])),
        ("Tier", text(record["tier"])),
        ("Verdict", text(verdict_of(record))),
        ("Method", text(submission.get("method", ""))),
        ("Description", text(submission.get("description", ""), 1500)),
        ("Authors", text(", ".join(submission.get("authors", [])))),
        ("Licence", text(submission.get("licence", ""))),
        ("Page", link(submission.get("url", ""))),
        ("Paper", link(submission.get("paper", ""))),
        ("Source code", _submitted_code(submission.get("code"))),
        ("Data", f"{source}, {_digests(digests)}"),
        ("Task", _pairs(task)),
        ("Seeds", text(", ".join(map(str, scores.get("seeds", []))))),
        ("Weights", _digests(scores.get("weights"))),
        ("Scored by", text(f"racines {code.get('version', '')} {code.get('commit') or ''}")),
        ("Environment", _pairs(scores.get("environment") or {})),
        ("Seconds", text(scores.get("seconds", ""))),
    ]


def _submitted_code(code: Any) -> str:
    if not isinstance(code, dict):
        return ""
    where = link(code["url"]) if "url" in code else text(code.get("package", ""))
    return f"{where} {text(code.get('commit', code.get('version', '')))}"


def _digests(digests: Any) -> str:
    pairs = digests.items() if isinstance(digests, dict) else ()
    return ", ".join(f"{text(k)} <code>{text(str(v)[:SHORT])}…</code>" for k, v in pairs)


def _pairs(content: dict[str, Any]) -> str:
    return text(", ".join(f"{k} {v}" for k, v in content.items() if v is not None))


def _figures(record: Record) -> str:
    """Return every figure with its n, its interval, and how that was made."""
    rows = []
    for name, metric in record["scores"]["metrics"].items():
        if metric["value"] is None:
            continue
        ends = [metric.get("low"), metric.get("high")]
        between = "–" if None in ends else " – ".join(f"{end:.4g}" for end in ends)
        how = (metric.get("settings") or {}).get("interval", "")
        rows.append((name, f"{metric['value']:.4g}", between, f"{metric['n']:,}", how))
    head = ("Figure", "Value", PERCENT, "n", "Interval by")
    return html.table(head, rows, ("rc-text", "", "", "", "rc-text"))
