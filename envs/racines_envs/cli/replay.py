"""The command `racines replay`: a recording run again. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt


def replay(
    recording: Annotated[Path, typer.Argument(help="An episode's JSONL file.")],
    as_json: opt.AsJson = False,
) -> None:
    """Run a recorded episode again; exit 1 if its poses do not repeat."""
    import json
    from dataclasses import asdict

    from racines_envs.recordings.rerun import rerun

    done = rerun(recording)
    if as_json:
        typer.echo(json.dumps(asdict(done), indent=2))
    else:
        typer.echo(
            f"{recording}: {done.steps} steps repeat within {done.position_error:.1e} m and "
            f"{done.rotation_error:.1e} rad"
        )
