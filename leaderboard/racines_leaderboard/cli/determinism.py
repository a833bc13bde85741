"""The command `racines determinism`."""

import json
from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command to the root."""
    app.command("determinism")(determinism)


def determinism(
    stage: Annotated[
        list[str] | None, typer.Option(help="Only stages that begin so; repeatable.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Write the report as JSON, stage by stage; a killed run goes on."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Measure how far each stage repeats itself: bitwise, or by the largest difference."""
    from racines_leaderboard.determinism.run import Outcome, determinism_markdown, measure

    def tell(outcome: Outcome) -> None:
        said = outcome.note or ("bitwise" if outcome.bitwise else f"{outcome.largest:.2g}")
        line = f"{outcome.stage}, {outcome.compared}: {said} ({outcome.seconds} s)"
        typer.echo(f"racines: {line}", err=True)

    document = measure(stage or (), tell, out)
    typer.echo(json.dumps(document, indent=2) if as_json else determinism_markdown(document))
