"""The command `racines train encoder`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_envs.cli.settings import phantom_config, read_settings
from racines_models.cli.scores import Device


def register(train: typer.Typer) -> None:
    """Add `encoder` to `racines train`."""
    train.command("encoder")(train_encoder)


def train_encoder(
    out: Annotated[Path, typer.Option(help="Folder of the run.")] = Path("models/runs/encoder"),
    frames: Annotated[int | None, typer.Option(help="Frames drawn; section encoder.")] = None,
    generator: Annotated[
        str | None, typer.Option(help="Who draws the images: name, run folder or ONNX; phantom.")
    ] = None,
    params: Annotated[
        Path | None, typer.Option(help="Settings; ./params.yaml if it is there.")
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option(help="Packaged settings: smoke, default, reference, paper or abdomen."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed; default: the params file's.")] = None,
    device: Device = "auto",
    resume: Annotated[
        bool | None,
        typer.Option("--resume/--fresh", help="Continue a run, or start anew; else as it fits."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the metrics as JSON.")] = False,
) -> None:
    """Train what image agents look through, on frames drawn where tasks go."""
    from racines_data.config import fill, section
    from racines_envs.worlds.exploration import ExplorationConfig
    from racines_envs.worlds.exploration import train_encoder as train
    from racines_models.cli.output import show_metrics
    from racines_models.protocol import Run

    settings = read_settings(params, profile)
    phantom = phantom_config(settings)
    values = {"anatomy": phantom.anatomy, **section(settings, "encoder")}
    values |= {} if frames is None else {"frames": frames}
    values |= {} if generator is None else {"generator": generator}
    config = fill(ExplorationConfig, values, "encoder")
    chosen = settings.get("seed", 0) if seed is None else seed
    metrics = train(config, Run(out, chosen, device, resume, progress=not as_json), phantom)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    show_metrics(f"encoder, {metrics['split']} split", metrics["metrics"])
    typer.echo(f"{out}: {metrics['training']['images_per_second']} images/s in training")
