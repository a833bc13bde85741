"""The command `racines doctor`. Heavy imports stand inside, so that --help is quick."""

from typing import Annotated

import typer

from racines_data.cli import options as opt


def doctor(
    full: Annotated[bool, typer.Option("--full", help="Hash the published weights.")] = False,
    as_json: opt.AsJson = False,
) -> None:
    """Say what is installed, what this machine has, whether data and weights are whole.

    Exit 1 if something is broken: a package or a file that is missing, damaged, or outside what is
    tested. Each problem is told with its remedy; what to run next stands last.
    """
    from racines_data.terminal import say_json, say_page
    from racines_leaderboard.doctor.examine import examine, page

    report = examine(full)
    if as_json:
        say_json(report, indent=2)
    else:
        say_page(page(report))
    if report["problems"]:
        raise typer.Exit(1)
