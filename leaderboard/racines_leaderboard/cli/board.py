"""The command `racines leaderboard`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.config import fill, read_params, section
from racines_data.errors import RacinesError
from racines_data.terminal import console, note, say, say_json

CACHE = Path("models/runs/scores/reference")
"""What is computed of the reference alone, shared with `racines eval generator`."""


def leaderboard(
    board: Annotated[
        str | None, typer.Option(help="Board to collect into, or the only one to show.")
    ] = None,
    collect: Annotated[
        list[Path] | None,
        typer.Option(help="Take the scores of this folder into the board first; repeatable."),
    ] = None,
    recompute: Annotated[
        list[str] | None,
        typer.Option(
            help="Score this submission again first, NAME or TRACK/NAME; repeatable. With --secret "
            "and --board, a merged agent on patients too."
        ),
    ] = None,
    data: opt.Data = opt.DATA,
    no_grader: opt.NoGrader = False,
    results: opt.Results = opt.RESULTS,
    submissions: opt.Submissions = opt.SUBMISSIONS,
    params: opt.Params = None,
    secret: opt.Secret = None,
    unconfined: opt.Unconfined = False,
    markdown: Annotated[
        Path | None, typer.Option(help="Write all boards to this file, charts beside the results.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="Write all boards to this file, one page for a browser.")
    ] = None,
    readme: Annotated[
        Path | None, typer.Option(help="Renew the tables between the marks of this file.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Write every figure of what is shown to this CSV file.")
    ] = None,
    force: opt.Force = False,
    details: opt.Details = False,
    as_json: opt.AsJson = False,
) -> None:
    """Collect scores into a board, or make them again, rank it, and show it.

    With --params, `board` of that file names the board. A record of another result stays in its
    place, unless --force is given; the same may be collected again. With --secret, what is scored
    again is also scored on fresh draws, beside its record, and what does not fit is told; of a
    merged agent on patients the record stays as it is.
    """
    from racines_data.files import write_atomic
    from racines_leaderboard.board import collect as results_of
    from racines_leaderboard.board.pages import with_tables, write_page
    from racines_leaderboard.board.table import board_csv, board_tables, plain, published, show
    from racines_leaderboard.board.web.page import write_html
    from racines_leaderboard.fresh.flags import flag_notes

    asked = board
    if params is not None:
        board = _board_of(params, board)
    if collect:
        if board is None:
            raise RacinesError("--collect needs --board NAME or --params FILE")
        others = results_of.made_elsewhere(collect, board) if params is not None else []
        for path in others:
            say(f"racines: left out {path}: made for another board than {board}", err=True)
        results_of.collect(collect, results, submissions, board, others, force)
    if secret is not None and not recompute:
        raise typer.BadParameter("--secret goes with --recompute: name what is to be drawn")
    names = [board] if board else results_of.boards(results)
    if recompute:
        names = score_again(
            recompute, asked, params, data, no_grader, results, submissions, unconfined, force,
            secret,
        )  # fmt: skip
    if not set(names) <= set(results_of.boards(results)) or not names:
        raise RacinesError(f"{results}: no results of {' and '.join(names) or 'any board'}")
    if markdown is not None:
        write_page(markdown, results)
    if html is not None:
        write_html(html, results)
    if readme is not None:
        if not readme.is_file():
            raise RacinesError(f"{readme}: no such file")
        write_atomic(readme, with_tables(readme.read_text(encoding="utf-8"), results, str(readme)))
    content = {name: results_of.read_board(results, name) for name in names}
    if csv is not None:
        write_atomic(csv, board_csv(content))
    if as_json:
        ranked = {name: plain(records) for name, records in content.items()}
        document = {"boards": ranked, "reported_in_the_paper": published()}
        say_json(document, indent=2)
        return
    shown = console()
    for name, records in content.items():
        for table in board_tables(name, records, details):
            show(table, shown)
        for flag in flag_notes(results / name, records):
            say(flag)


def score_again(
    names: list[str], board: str | None, params: Path | None, data: Path, no_grader: bool,
    results: Path, submissions: Path, unconfined: bool, force: bool, secret: Path | None,
) -> list[str]:  # fmt: skip
    """Score submissions again on boards that settings make, and in secret; return the boards."""
    from racines_leaderboard.audit.bench import Bench, Places
    from racines_leaderboard.board import recompute as scoring
    from racines_leaderboard.board.belonging import board_of
    from racines_leaderboard.cli.secret import today
    from racines_leaderboard.fresh import draw_in_secret, read_secret
    from racines_leaderboard.fresh.merged import draw_merged
    from racines_leaderboard.submissions.confined.session import Limits
    from racines_models.scores.scoring import ScoresConfig

    settings = read_params(params or Path("params.yaml"))
    told = fill(ScoresConfig, section(settings, "scores"), "scores")
    grader, pose = None if no_grader else Path(told.grader), Path(told.pose)
    pose = pose if pose.is_dir() else None
    limits = Limits(unconfined=unconfined)
    merged = {} if secret is None else _merged(names, board, results)
    bench = Bench(board or "", Places(results, submissions, data, params or Path("params.yaml")))
    for name, path in merged.items():
        assert secret is not None
        opened = read_secret(secret, results, bench.board)
        _tell_drawn(name, draw_merged(path, bench, opened, today(), force))
    folders = [scoring.find(submissions, name) for name in names if name not in merged]
    boards = [board_of(folder, settings, board) for folder in folders]
    for folder, board in zip(folders, boards, strict=True):
        ground = scoring.Ground(board, settings, data, grader, pose, CACHE, limits)
        opened = None if secret is None else read_secret(secret, results, board)
        record = scoring.recompute(folder, ground, results, force)
        told = f"{record['track']}/{record['name']}"
        note(f"racines: scored again: {told}")
        if opened is not None:
            _tell_drawn(told, draw_in_secret(folder, ground, results, opened, today(), force, True))
    boards += [bench.board] if merged else []
    return list(dict.fromkeys(boards))


def _merged(names: list[str], board: str | None, results: Path) -> dict[str, Path]:
    """Return the records of a board that are of merged agents, by the names that were given."""
    from racines_leaderboard.fresh.merged import merged_record

    found = {name: merged_record(results, board, name) for name in names}
    return {name: path for name, path in found.items() if path is not None}


def _tell_drawn(name: str, drawn: dict[str, Any]) -> None:
    flags = "; ".join(drawn["flags"]) or "no flag"
    note(f"racines: drawn in secret, round {drawn['round']}: {name}: {flags}")


def _board_of(params: Path, board: str | None) -> str:
    """Return the board that was asked for, if a params file makes it; the main one if none was."""
    values = read_params(params)
    named = values.get("board")
    if not isinstance(named, str):
        raise RacinesError(f"{params}: board: expected the name of a board")
    made = (named, *values.get("patient_boards", ()))
    if board not in (None, *made):
        raise RacinesError(f"--board {board} differs from {', '.join(made)}, made by {params}")
    return board or named
