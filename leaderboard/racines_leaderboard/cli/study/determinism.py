"""The command `racines study determinism`."""

import json
from typing import Annotated

import typer

from racines_data.cli import options as opt


def determinism(
    stage: Annotated[
        list[str] | None, typer.Option(help="Only stages that begin so; repeatable.")
    ] = None,
    out: opt.OwnOutFile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Measure how far each stage repeats itself: bitwise, or by the largest difference.

    With --out the report is written as JSON, stage by stage; a killed run goes on.
    """
    from racines_leaderboard.determinism.run import Outcome, determinism_markdown, measure

    def tell(outcome: Outcome) -> None:
        said = outcome.note or ("bitwise" if outcome.bitwise else f"{outcome.largest:.2g}")
        line = f"{outcome.stage}, {outcome.compared}: {said} ({outcome.seconds} s)"
        typer.echo(f"racines: {line}", err=True)

    document = measure(stage or (), tell, out)
    typer.echo(json.dumps(document, indent=2) if as_json else determinism_markdown(document))
