"""The command `racines study population`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt

if TYPE_CHECKING:
    from rich.table import Table


def population(
    split: opt.Split = "train",
    patients: Annotated[int, typer.Option(min=1, help="So many of them, the first.")] = 200,
    out: opt.Report = Path("models/runs/population"),
    as_json: opt.AsJson = False,
) -> None:
    """Measure simulated patients: chambers, walls, volumes, by sex and pathology, beside norms.

    OUT.json is what `study real-heart --population` reads.
    """
    from racines_data.files import write_atomic, write_json
    from racines_data.progress import progress_bar
    from racines_models.cli.output import tell
    from racines_models.studies.population import draw, survey

    with progress_bar(not as_json) as bar:
        task = bar.add_task("patients", total=patients)
        content = survey(split, patients, lambda done: bar.update(task, completed=done))
    write_json(out.with_suffix(".json"), content)
    write_atomic(out.with_suffix(".png"), draw(content))
    tell(content, as_json, *_tables(content), f"{out}.json, {out}.png")


def _tables(content: dict[str, Any]) -> "list[Table]":
    from racines_data.tables import console_table
    from racines_models.studies.population import tables_of

    return [console_table(*each, "mean ± SD, range") for each in tables_of(content)]
