"""Commands: train student, eval grader. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_models.cli.scores import (
    DATA,
    GRADER,
    AsJson,
    Data,
    Device,
    Params,
    Profile,
    read_values,
)

STUDENT = Path("models/runs/student")


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add `student` to `racines train`, `grader` to `racines eval`."""
    train.command("student")(train_student)
    evaluate.command("grader")(eval_grader)


def train_student(
    data: Data = DATA,
    teacher: Annotated[Path, typer.Option(help="Folder of the grader to learn from.")] = GRADER,
    out: Annotated[Path, typer.Option(help="Folder of the run.")] = STUDENT,
    params: Params = None,
    profile: Profile = None,
    seed: Annotated[int | None, typer.Option(help="Seed; default: the params file's.")] = None,
    device: Device = "auto",
    resume: Annotated[
        bool | None,
        typer.Option(
            "--resume/--fresh",
            help="Continue a killed run, or start anew. Without either: continue if one is there.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Distil a small, quick student from a trained grader; report how far the two agree."""
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_metrics
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.student.model import StudentConfig
    from racines_models.judges.student.training import train_student
    from racines_models.protocol import Run

    values = read_values(params, profile)
    config = fill(StudentConfig, section(values, "student"), "student")
    chosen = values.get("seed", 0) if seed is None else seed
    store, master = open_store(data), Grader.load(teacher, device)
    run = Run(out, chosen, device, resume, progress=not as_json)
    metrics = train_student(store, config, run, master)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    agreed = {f"agreement, {k}": v for k, v in metrics["agreement"].items() if k != "split"}
    show_metrics(f"student, {metrics['split']} split", agreed | _figures(metrics))
    rates = metrics["speed"]
    typer.echo(
        f"{out}: {rates['student']:,.0f} images/s, {rates['ratio']:.1f} times the teacher's "
        f"{rates['teacher']:,.0f} (batch {rates['batch_size']}, {rates['threads']} threads)"
    )


def eval_grader(
    run: Annotated[Path, typer.Argument(help="Folder of a grader or a student.")] = GRADER,
    data: Data = DATA,
    split: Annotated[str, typer.Option(help="train, validation or test.")] = "test",
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of metrics.json and the plots.  [default: RUN, or RUN/SPLIT]"),
    ] = None,
    recalibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="First fit its temperature on the validation split."),
    ] = False,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Report a grader on a split: accuracy, calibration, grade error by view, and the plots."""
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_metrics
    from racines_models.judges.grader.evaluation import evaluate_grader

    out = out or (run if split == "test" else run / split)
    metrics = evaluate_grader(run, open_store(data), split, out, recalibrate, device)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    show_metrics(f"{run}, {split} split", _figures(metrics))
    typer.echo(f"{out}: metrics.json, {', '.join(metrics['plots'])}")


def _figures(metrics: dict[str, Any]) -> dict[str, Any]:
    shown = metrics["metrics"] | {
        f"view_accuracy, {name}": figure for name, figure in metrics["views"].items()
    }
    for name, figures in metrics["grades"].items():
        shown |= {f"grade_{kind}, {name}": figure for kind, figure in figures.items()}
    calibration = metrics["calibration"]
    for when in ("before", "after"):
        if when in calibration:
            shown[f"calibration_error, {when}"] = calibration[when]
    return shown
