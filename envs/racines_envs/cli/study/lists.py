"""What the studies of agents take as lists, and where they write."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

SCORES = Path("envs/runs/scores")
Seeds = Annotated[str | None, typer.Option(help="Start sets, comma-separated: 0,1,2.")]


def listed(values: list[str]) -> list[str]:
    """Return the words of lists that are separated by commas."""
    return [word for value in values for word in value.split(",") if word]


def integers(text: str | None) -> tuple[int, ...] | None:
    """Return the integers of a list; what is none is bad usage."""
    try:
        return None if text is None else tuple(int(word) for word in listed([text]))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}: give integers, comma-separated") from error


def say(content: dict[str, Any], table: str, out: Path, as_json: bool) -> None:
    """Print a study as JSON, or its table and where it was written."""
    if as_json:
        typer.echo(json.dumps(content, indent=2))
    else:
        typer.echo(table)
        typer.echo(f"written: {out}, {out.with_suffix('.png').name}, {out.with_suffix('.md').name}")
