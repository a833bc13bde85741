"""Pages made of boards: the leaderboard's Markdown with its charts, and the tables of a README."""

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_data.escape import visible
from racines_data.files import write_atomic
from racines_data.plotting import GRID, NO_VIEW, OURS, card_style, encode
from racines_data.tables import escape
from racines_leaderboard.board.about import about
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.rank import SCORE, Ranked, Record, rankings
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.board.table import (
    board_tables,
    shown_columns,
    shown_metric,
    titled_markdown,
)
from racines_leaderboard.fresh.flags import flag_notes
from racines_leaderboard.records.columns import PERCENT, Column, Track
from racines_leaderboard.records.tracks import TRACKS

BEGIN = "<!-- leaderboard {board}: written by `racines leaderboard --readme` -->"
END = "<!-- end of leaderboard -->"
HEAD = """# Leaderboard

Research software, not a medical device. Written by `racines leaderboard --markdown`; do not edit.
One board a dataset; results stand in `results/<board>/`, one JSON file a system.
Tiers: *self-reported* (the submitter's own run), *recomputed* (scores made again from the
artefacts), *reproduced* (trained again).
"""
DPI = 150
PANELS_A_ROW = 5


def _tables(folder: Path, content: dict[str, list[Record]], details: bool = False) -> str:
    """Return the tables of a board as Markdown, with `details` also of the further figures."""
    board = folder.name
    flags = [escape(note) for note in flag_notes(folder, content)]
    tables = board_tables(board, content, details)
    return "\n\n".join([*(titled_markdown(table) for table in tables), *flags])


def write_page(page: Path, results: Path) -> None:
    """Write the page of all boards, and beside each board's results its charts."""
    parts = [HEAD]
    for board in boards(results):
        content = read_board(results, board)
        head = f"## {escape(board)}\n\n{about(board)}"
        parts.append(f"{head}\n\n{_tables(results / board, content, details=True)}\n")
        for track in TRACKS:
            image = results / board / f"{track.name}.png"
            if _write_chart(image, track, content[track.name]):
                where = quote(os.path.relpath(image, page.parent))
                parts.append(f"![{track.name} of {escape(board)}]({where})\n")
    write_atomic(page, "\n".join(parts))


def with_tables(text: str, results: Path, where: str) -> str:
    """Return a README's text with the tables between its marks made anew."""
    opening, closing = BEGIN.split("{board}")
    before, found, rest = text.partition(opening)
    board, named, rest = rest.partition(closing)
    _, ended, after = rest.partition(END)
    if not (found and named and ended):
        raise RacinesError(f"{where}: needs the lines {BEGIN.format(board='BOARD')!r} and {END!r}")
    if board not in boards(results):
        raise RacinesError(f"{where}: board {board!r} has no results under {results}")
    tables = _tables(results / board, read_board(results, board))
    return f"{before}{opening}{board}{closing}\n\n{about(board)}\n\n{tables}\n\n{END}{after}"


@card_style()
def _write_chart(path: Path, track: Track, records: list[Record]) -> bool:
    """Draw the results of a track, a panel a figure; return False where there is none to draw."""
    ranking = rankings(track, records)
    columns = shown_columns((SCORE, *track.columns), ranking)
    if not columns:
        return False
    down = -(-len(columns) // PANELS_A_ROW)
    across = -(-len(columns) // down)
    height = 0.9 + 0.32 * len(ranking)
    canvas = Figure(figsize=(1.6 + 2.5 * across, 0.5 + height * down), layout="constrained")
    axes = canvas.subplots(down, across, squeeze=False, sharey=True)
    for axis in axes.flat[len(columns) :]:
        axis.set_visible(False)
    for axis, column in zip(axes.flat, columns, strict=False):
        panel(axis, column, ranking)
    top = "best at the top; " if SCORE in columns else ""
    shown = [shown_metric(ranked.record, columns[0]) for ranked in ranking]
    counts = " or ".join(f"{n:,}" for n in sorted({each["n"] for each in shown if each}))
    told = f"bars are {PERCENT} intervals, n = {counts} {track.counted}; open gray: bounds"
    canvas.suptitle(f"{track.name.capitalize()}: {top}{told}", size=10.5)
    write_atomic(path, encode(canvas, dpi=DPI))
    return True


def panel(axis: Axes, column: Column, ranking: Sequence[Ranked]) -> None:
    """Draw one figure of N results, a line each, as dots with their intervals."""
    for row, ranked in enumerate(ranking):
        bound = is_bound(ranked.record)
        ink, fill = (NO_VIEW, "white") if bound else (OURS, OURS)
        metric = shown_metric(ranked.record, column)
        if metric is None:
            continue
        value = metric["value"] * column.scale
        if metric["low"] is not None and metric["high"] is not None:
            ends = [metric["low"] * column.scale, metric["high"] * column.scale]
            axis.plot(ends, [row, row], color=ink, alpha=0.45, linewidth=3.5, solid_capstyle="butt")
        axis.plot([value], [row], "o", color=ink, markerfacecolor=fill, markersize=5.5)
    named = [(ranked.record["name"], ranked.record["scores"].get("task")) for ranked in ranking]
    labels = [visible(f"{name} ({task['view']})" if task else name) for name, task in named]
    axis.set_yticks(range(len(ranking)), labels, size=9, parse_math=False)
    axis.set_ylim(len(ranking) - 0.4, -0.6)
    axis.set_title(column.title, size=9)
    axis.tick_params(axis="y", length=0)
    axis.grid(visible=False, axis="y")
    axis.grid(visible=True, axis="x", color=GRID)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
