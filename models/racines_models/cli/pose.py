"""The command `racines train pose`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_models.cli.scores import DATA, POSE, AsJson, Data, Device, Params, Profile, read_values


def register(train: typer.Typer) -> None:
    """Add `pose` to `racines train`."""
    train.command("pose")(train_pose)


def train_pose(
    data: Data = DATA,
    out: Annotated[Path, typer.Option(help="Folder of the run.")] = POSE,
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
    """Train the pose regressor, which reads the pose back from an image; report on the test split.

    Settings: section `pose` of the params file.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_metrics
    from racines_models.judges.pose import training as pose_training
    from racines_models.judges.pose.regressor import PoseConfig
    from racines_models.protocol import Run

    values = read_values(params, profile)
    config = fill(PoseConfig, section(values, "pose"), "pose")
    chosen = values.get("seed", 0) if seed is None else seed
    run = Run(out, chosen, device, resume, progress=not as_json)
    metrics = pose_training.train_pose(open_store(data), config, run)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    show_metrics(f"pose regressor, {metrics['split']} split", metrics["metrics"])
    typer.echo(f"{out}: {metrics['training']['images_per_second']} images/s in training")
