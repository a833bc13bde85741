"""The command `racines eval forces`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer


def register(evaluate: typer.Typer) -> None:
    """Add `forces` to `racines eval`."""
    evaluate.command("forces")(forces)


def forces(
    data: Annotated[Path, typer.Option(help="Folder of the dataset.")] = Path("data/racines"),
    split: Annotated[str, typer.Option(help="Held-out split: validation or test.")] = "test",
    out: Annotated[Path, typer.Option(help="The report, JSON.")] = Path(
        "envs/runs/scores/forces.json"
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Fit forces on the train split and tell their errors on trajectories not seen."""
    from racines_data.errors import RacinesError
    from racines_data.files import write_json
    from racines_data.store.frames import open_store
    from racines_envs.studies.forces import force_markdown, force_report

    if split == "train":
        raise RacinesError("--split train: the forces are fitted on it; choose validation or test")
    report = force_report(open_store(data), split=split)
    write_json(out, report)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    typer.echo(force_markdown(report))
    typer.echo(f"held out: {report['frames'][split]} frames of split {split}; written: {out}")
