"""The command `racines drive`: the probe by hand. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given


def drive(
    view: opt.View = "SC",
    anatomy: Annotated[str | None, typer.Option(help="Whose view; the heart's.")] = None,
    backend: opt.Backend = "phantom",
    generator: opt.Generator = None,
    data: opt.OtherData = None,
    reward: opt.Reward = "oracle",
    grader: opt.Grader = None,
    seed: opt.DrawSeed = 0,
    png: Annotated[
        Path | None, typer.Option(help="Renew this file with the picture after every key.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write each episode there, as JSONL and GIF.")
    ] = None,
    keys: Annotated[
        str | None, typer.Option(help="Press these keys and stop; needs no terminal.")
    ] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Drive the probe from the keyboard; the keys stand under the picture."""
    import json

    from racines_envs.driving.keyboard import Drive, run
    from racines_envs.driving.terminal import Terminal
    from racines_envs.worlds.making import make_core

    terminal = Terminal() if keys is None else None  # refused before anything is made
    settings = given(
        view=view, backend=backend, generator=generator, data=data, reward=reward,
        grader=grader, anatomy=anatomy,
    )  # fmt: skip
    core = make_core(**settings, observation="image")
    session = Drive(core, seed, png, record)
    if terminal is None:
        run(session, keys or "")
    else:
        with terminal:
            run(session, terminal.keys(), terminal.show)
    if as_json:
        info = {name: value[0].item() for name, value in core.info().items()}
        typer.echo(json.dumps(info, indent=2))
    else:
        typer.echo("\n".join(session.words()[:-3]))
