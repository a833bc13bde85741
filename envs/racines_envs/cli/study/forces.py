"""The command `racines study forces`. Heavy imports stand inside, so that --help is instant."""

import json

import typer

from racines_data.cli import options as opt
from racines_envs.cli.study.lists import SCORES


def forces(
    data: opt.Data = opt.DATA,
    split: opt.Split = "test",
    out: opt.OutFile = SCORES / "forces.json",
    as_json: opt.AsJson = False,
) -> None:
    """Fit forces on the train split and tell their errors on trajectories not seen."""
    from racines_data.errors import RacinesError
    from racines_data.files import write_json
    from racines_data.store.frames import open_store
    from racines_envs.worlds.forces import force_report, forces_markdown

    if split == "train":
        raise RacinesError("--split train: the forces are fitted on it; choose validation or test")
    report = force_report(open_store(data), split=split)
    write_json(out, report)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    typer.echo(forces_markdown(report))
    typer.echo(f"held out: {report['frames'][split]} frames of split {split}; written: {out}")
