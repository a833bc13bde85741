"""The command `racines train encoder`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, read_settings, seed_of
from racines_envs.cli.settings import phantom_config
from racines_models.cli.device import Device


def train_encoder(
    out: opt.Out = Path("models/runs/encoder"),
    frames: Annotated[int | None, typer.Option(help="Frames drawn; section encoder.")] = None,
    generator: opt.Generator = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train what image agents look through, on frames drawn where tasks go."""
    from racines_data.config import fill, section
    from racines_envs.worlds.exploration import ExplorationConfig
    from racines_envs.worlds.exploration import train_encoder as train
    from racines_models.cli.output import show_training
    from racines_models.protocol import Run

    settings = read_settings(params, profile)
    phantom = phantom_config(settings)
    values = {"anatomy": phantom.anatomy, **section(settings, "encoder")}
    values |= given(frames=frames, generator=generator)
    config = fill(ExplorationConfig, values, "encoder")
    run = Run(out, seed_of(settings, seed), device, resume, progress=not as_json)
    show_training("encoder", out, train(config, run, phantom), as_json)
