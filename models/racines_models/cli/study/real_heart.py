"""The command `racines study real-heart`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt

if TYPE_CHECKING:
    from rich.table import Table


def real_heart(
    real: Annotated[Path, typer.Option(help="Folder of one heart's surfaces, OBJ, a phase each.")],
    population: Annotated[
        Path | None, typer.Option(help="JSON of a population's measures, a mapping a patient.")
    ] = None,
    out: opt.Report = Path("models/runs/real-heart"),
    as_json: opt.AsJson = False,
) -> None:
    """Measure a real heart over its beat: volumes, ejection fraction, shortening, thickness.

    With a population's measures, it is said where in their spread the heart lies.
    """
    from racines_data.files import write_atomic, write_json
    from racines_models.cli.output import tell
    from racines_models.studies.real_heart.measures import measure_phases, read_heart
    from racines_models.studies.real_heart.report import compare, draw, read_population

    patients = read_population(population) if population else None
    content = compare(measure_phases(read_heart(real)), patients)
    write_atomic(out.with_suffix(".png"), draw(content))
    write_json(out.with_suffix(".json"), content)
    tell(content, as_json, _table(content), f"{out}.json, {out}.png")


def _table(content: dict[str, Any]) -> "Table":
    from racines_data.tables import console_table

    populations = content["population"]
    rows = []
    for name, row in content["measures"].items():
        cells = [f"{row['value']:.1f} {row['unit']}"]
        for group in populations.values():
            each = group.get(name)
            if each is None:
                cells.append("-")
                continue
            deviation = "" if each["sd"] is None else f" ± {each['sd']:.1f}"
            cells.append(f"{each['mean']:.1f}{deviation} ({each['low']:.1f} to {each['high']:.1f})")
        if populations:
            inside = row.get("inside")
            cells.append("-" if inside is None else "inside" if inside else "outside")
        rows.append((name, *cells))
    head = ("measure", "one real heart", *populations, *(("spread",) if populations else ()))
    told = "; population: mean ± SD (range)" if populations else ""
    title = f"one heart, {len(content['phases'])} phases{told}"
    return console_table(head, rows, title)
