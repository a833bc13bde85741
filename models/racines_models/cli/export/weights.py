"""The command `racines export weights`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt


def export_weights(
    run: Annotated[Path, typer.Argument(help="Folder of a trained run.")],
    out: opt.OwnOut = None,
    as_json: opt.AsJson = False,
) -> None:
    """Copy a run's weights in half precision, with hashes and how they were trained.

    They go to models/weights/NAME, or --out.
    """
    from racines_models.weights import publish

    folder = out or Path("models/weights") / run.resolve().name
    files = publish(run, folder)["weights_files"]["files"]
    if as_json:
        typer.echo(json.dumps({"out": str(folder), "files": files}))
        return
    for name, each in files.items():
        typer.echo(f"{folder / name}: {each['bytes'] / 1e6:.2f} MB, sha256 {each['sha256'][:12]}…")
