"""The command `racines eval grader`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_models.cli.device import Device


def eval_grader(
    run: Annotated[Path, typer.Argument(help="Folder of a grader or a student.")] = opt.GRADER,
    data: opt.Data = opt.DATA,
    split: opt.Split = "test",
    out: opt.OwnOut = None,
    recalibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="First fit its temperature on the validation split."),
    ] = False,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Report a grader on a split: accuracy, calibration, grade error by view, and the plots.

    They go to --out, or RUN for the test split and RUN/SPLIT for the others.
    """
    from racines_data.store.frames import open_store
    from racines_models.cli.output import judge_figures, show_metrics
    from racines_models.judges.grader.evaluation import evaluate_grader

    out = out or (run if split == "test" else run / split)
    metrics = evaluate_grader(run, open_store(data), split, out, recalibrate, device)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    show_metrics(f"{run}, {split} split", judge_figures(metrics))
    typer.echo(f"{out}: metrics.json, {', '.join(metrics['plots'])}")
