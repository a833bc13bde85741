"""The command `racines study curves`. Heavy imports stand inside, so that --help is instant."""

from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_envs.cli.study.lists import SCORES, listed


def curves(
    runs: Annotated[
        list[str], typer.Argument(help="Run folders; LABEL=RUN joins seeds under one label.")
    ],
    paper: Annotated[
        bool, typer.Option("--paper/--no-paper", help="Draw the paper's levels.")
    ] = True,
    out: opt.OutFile = SCORES / "curves.png",
    as_json: opt.AsJson = False,
) -> None:
    """Draw success, steps and return of validations against environment steps."""
    import json

    from racines_envs.studies.curves import draw_curves, read_curves

    content = read_curves(listed(runs))
    draw_curves(content, out, paper)
    typer.echo(json.dumps(content) if as_json else f"written: {out}")
