"""Pages made of boards: the leaderboard's Markdown, and the block of tables in a README."""

import os
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_leaderboard.board.chart import write_chart
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.table import board_tables, titled_markdown
from racines_leaderboard.records.tracks import TRACKS

BEGIN = "<!-- leaderboard {board}: written by `racines leaderboard --readme` -->"
END = "<!-- end of leaderboard -->"
HEAD = """# Leaderboard

Research software, not a medical device. Written by `racines leaderboard --markdown`; do not edit.
One board a dataset; results stand in `results/<board>/`, one JSON file a system.
Tiers: *self-reported* (the submitter's own run), *recomputed* (scores made again from the
artefacts), *reproduced* (trained again).
"""


def board_markdown(results: Path, board: str, details: bool = False) -> str:
    """Return the tables of a board as Markdown, with `details` also of the further figures."""
    tables = board_tables(board, read_board(results, board), details)
    return "\n\n".join(titled_markdown(table) for table in tables)


def write_page(page: Path, results: Path) -> None:
    """Write the page of all boards, and beside each board's results its charts."""
    parts = [HEAD]
    for board in boards(results):
        parts.append(f"## {board}\n\n{board_markdown(results, board, details=True)}\n")
        parts.extend(_chart_links(page, results, board))
    page.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(page, "\n".join(parts))


def with_tables(text: str, results: Path, where: str) -> str:
    """Return a README's text with the tables between its marks made anew.

    Raises:
        RacinesError: no marks, a mark without its end, or a board without results.
    """
    opening, closing = BEGIN.split("{board}")
    before, found, rest = text.partition(opening)
    board, named, rest = rest.partition(closing)
    _, ended, after = rest.partition(END)
    if not (found and named and ended):
        raise RacinesError(f"{where}: needs the lines {BEGIN.format(board='BOARD')!r} and {END!r}")
    if board not in boards(results):
        raise RacinesError(f"{where}: board {board!r} has no results under {results}")
    tables = board_markdown(results, board)
    return f"{before}{BEGIN.format(board=board)}\n\n{tables}\n\n{END}{after}"


def _chart_links(page: Path, results: Path, board: str) -> list[str]:
    content = read_board(results, board)
    links = []
    for track in TRACKS:
        image = results / board / f"{track.name}.png"
        if write_chart(image, track, content[track.name]):
            link = os.path.relpath(image, page.parent)
            links.append(f"![{track.name} of {board}]({link})\n")
    return links
