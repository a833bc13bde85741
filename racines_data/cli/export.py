"""The command `racines data export`: a dataset in other people's formats."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt


def export(
    root: Annotated[Path, typer.Argument(help="Folder of the dataset.")],
    format: Annotated[str, typer.Option("--format", help="release, lerobot or minari.")],
    out: opt.Out,
    split: opt.OneSplit = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Frames to write, the first.")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write a dataset, or one split, in another format; images are never compressed with loss."""
    from racines_data.export.registry import load_exporter

    made = load_exporter(format)(root, out, split=split, limit=limit, progress=not as_json)
    if as_json:
        typer.echo(json.dumps(made))
    else:
        _print(made)


def _print(made: dict[str, Any]) -> None:
    typer.echo(
        f"{made['out']}: {made['frames']} frames in {made['trajectories']} trajectories, "
        f"format {made['format']}"
    )
    for note in made.get("notes", []):
        typer.echo(f"note: {note}")
