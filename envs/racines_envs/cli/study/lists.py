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


def publish(content: dict[str, Any], table: str, out: Path, as_json: bool) -> None:
    """Write a study and its table, and print it as JSON or as that table."""
    from racines_data.files import write_atomic, write_json

    write_atomic(out.with_suffix(".md"), table)
    write_json(out, content)
    if as_json:
        typer.echo(json.dumps(content, indent=2))
    else:
        typer.echo(table)
        typer.echo(f"written: {out}, {out.with_suffix('.png').name}, {out.with_suffix('.md').name}")
