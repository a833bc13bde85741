"""The commands `racines board pin` and `racines study weightings`."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.terminal import console, note, say, say_json

Board = Annotated[str, typer.Argument(help="Name of the board.")]


def pin(
    board: Board,
    scores: Annotated[
        list[Path] | None,
        typer.Option(help="Take the anchors' scores from this folder, not the board; repeatable."),
    ] = None,
    results: opt.Results = opt.RESULTS,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Write what a board's records are held to: its data, judges, metrics, starts and anchors.

    They are those of mean-image and noise-ceiling, and of random and planner, task by task. A
    pinned board stays as it is, unless --force is given; what changes is printed.
    """
    from racines_leaderboard.board.pinning import misfits, pin_board

    changes = pin_board(results, board, scores or (), force)
    lines = misfits(results, board)
    if as_json:
        say_json({"board": board, "changed": changes, "does_not_fit": lines})
    else:
        for change in changes:
            say(change)
    what = f"{len(changes)} fields pinned anew" if changes else "pinned so already"
    note(f"racines: board {board}: {what}")
    for line in lines:
        say(f"racines: does not fit: {line}", err=True)
    if lines:
        note(f"Next: racines leaderboard --board {board} --collect FOLDER --force")


def weightings(
    board: Board,
    results: opt.Results = opt.RESULTS,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the tables to this file as well.")
    ] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Show how the order of a board's systems changes under other weights of the metrics.

    By values alone, without intervals: every difference counts.
    """
    from racines_data.files import write_atomic
    from racines_leaderboard.board.table import show, titled_markdown
    from racines_leaderboard.board.weightings import orders, tables

    if as_json:
        say_json(orders(results, board), indent=2)
        return
    made = tables(results, board)
    if not made:
        say(f"board {board}: each of its tasks ranks by one metric, so there is no other order")
    if markdown is not None:
        write_atomic(markdown, "\n\n".join(titled_markdown(table) for table in made) + "\n")
    for table in made:
        show(table, console())
