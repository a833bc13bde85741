"""The command `racines train student`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_models.cli.device import Device


def train_student(
    data: opt.Data = opt.DATA,
    config: opt.Config = "frames",
    teacher: Annotated[Path, typer.Option(help="Folder of the grader to learn from.")] = opt.GRADER,
    out: opt.Out = Path("models/runs/student"),
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Distil a small, quick student from a trained grader; report how far the two agree."""
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import judge_figures, metrics_table, tell
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.student.model import StudentConfig
    from racines_models.judges.student.training import train_student
    from racines_models.protocol import Run

    values = read_settings(params, profile)
    settings = fill(StudentConfig, section(values, "student"), "student")
    store, master = open_store(data, config), Grader.load(teacher, device)
    run = Run(out, seed_of(values, seed), device, resume, progress=not as_json)
    metrics = train_student(store, settings, run, master)
    agreed = {f"agreement, {k}": v for k, v in metrics["agreement"].items() if k != "split"}
    title = f"student, {metrics['split']} split"
    table = metrics_table(title, agreed | judge_figures(metrics))
    rates = metrics["speed"]
    speed = (
        f"{out}: {rates['student']:,.0f} images/s, {rates['ratio']:.1f} times the teacher's "
        f"{rates['teacher']:,.0f} (batch {rates['batch_size']}, {rates['threads']} threads)"
    )
    tell({"out": str(out)} | metrics, as_json, table, speed)
