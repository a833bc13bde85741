"""The command `racines data validate`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError


def validate(
    root: opt.Root = None,
    against: Annotated[
        Path | None, typer.Option(help="Another build that should be the same version.")
    ] = None,
    workers: opt.Workers = 2,
    as_json: opt.AsJson = False,
) -> None:
    """Check files, digests, rows, splits, copies and statistics; exit 1 if anything is wrong."""
    from racines_data.manifest import default_root
    from racines_data.validate import run

    result = run.validate(default_root(root), against, workers or 1, progress=not as_json)
    if as_json:
        typer.echo(json.dumps(run.to_json(result)))
    else:
        run.print_validation(result)
    if not result.ok:
        broken = "; ".join(
            f"{each.name}: {each.detail}" for each in result.checks if each.binding and not each.ok
        )
        raise RacinesError(f"{default_root(root)}: not valid: {broken}")
