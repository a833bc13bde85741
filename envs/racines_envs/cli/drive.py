"""Commands: `racines drive`, the probe by hand, and `racines replay`, a recording run again."""

from pathlib import Path
from typing import Annotated, Any

import typer


def register(app: typer.Typer) -> None:
    """Add the commands to the root."""
    app.command("drive")(drive)
    app.command("replay")(replay)


def drive(
    view: Annotated[str, typer.Option(help="Target view.")] = "SC",
    anatomy: Annotated[str | None, typer.Option(help="Whose view; the heart's.")] = None,
    backend: Annotated[str, typer.Option(help="phantom, generator or replay.")] = "phantom",
    generator: Annotated[str | None, typer.Option(help="Generator: name or run folder.")] = None,
    data: Annotated[Path | None, typer.Option(help="Dataset folder, to replay.")] = None,
    reward: Annotated[str, typer.Option(help="paper, oracle or shaped.")] = "oracle",
    grader: Annotated[str | None, typer.Option(help="Grader: run folder.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the starts.")] = 0,
    png: Annotated[
        Path | None, typer.Option(help="Renew this file with the picture after every key.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write each episode there, as JSONL and GIF.")
    ] = None,
    keys: Annotated[
        str | None, typer.Option(help="Press these keys and stop; needs no terminal.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the last state as JSON.")] = False,
) -> None:
    """Drive the probe from the keyboard; the keys stand under the picture."""
    import json

    from racines_envs.driving.keyboard import Drive, run
    from racines_envs.driving.terminal import Terminal
    from racines_envs.worlds.making import make_core

    terminal = Terminal() if keys is None else None  # refused before anything is made
    settings: dict[str, Any] = {
        "generator": generator, "data": data, "grader": grader, "anatomy": anatomy
    }  # fmt: skip
    core = make_core(view, observation="image", backend=backend, reward=reward, **settings)
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


def replay(
    recording: Annotated[Path, typer.Argument(help="An episode's JSONL file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Run a recorded episode again; exit 1 if its poses do not repeat."""
    import json
    from dataclasses import asdict

    from racines_envs.recordings.replay import replay as run_again

    done = run_again(recording)
    if as_json:
        typer.echo(json.dumps(asdict(done), indent=2))
    else:
        typer.echo(
            f"{recording}: {done.steps} steps repeat within {done.position_error:.1e} m and "
            f"{done.rotation_error:.1e} rad"
        )
