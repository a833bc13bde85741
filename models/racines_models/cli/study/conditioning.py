"""The command `racines study conditioning`. Heavy imports stand inside."""

import dataclasses
import json
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import read_settings, seed_of
from racines_models.cli.device import Device


def conditioning(
    name: Annotated[str, typer.Argument(help="A generator with conditioning and injection.")],
    data: opt.Data = opt.DATA,
    out: opt.OwnOut = None,
    images: Annotated[
        int | None, typer.Option(min=1, help="Training images of each variant; default: params'.")
    ] = None,
    frames: Annotated[int, typer.Option(min=2, help="Validation frames that judge.")] = 500,
    pose: opt.Pose = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Train a generator four ways (Euler or continuous, concat or norm) and compare them.

    A pose regressor adds the error of the poses; all goes to models/runs/conditioning-NAME.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.protocol import Run
    from racines_models.registry import generator_class
    from racines_models.studies.conditioning import folder_of, run_ablation

    cls, values = generator_class(name), read_settings(params, profile)
    settings = section(values, ("generators", cls.name))
    config: Any = fill(cls.Config, settings, f"generators.{cls.name}")
    if images is not None:
        config = dataclasses.replace(
            config, training=dataclasses.replace(config.training, images=images)
        )
    regressor = PoseRegressor.load(pose, device) if pose else None
    run = Run(out or folder_of(cls.name), seed_of(values, seed), device, progress=not as_json)
    content = run_ablation(cls, config, open_store(data), run, frames, regressor)
    if as_json:
        typer.echo(json.dumps(content))
    else:
        _show(content)


def _show(content: dict[str, Any]) -> None:
    from rich.console import Console

    from racines_data.tables import console_table

    title = f"{content['generator']}, {content['n']} {content['split']} frames"
    figures = [key for key, value in content["variants"][0].items() if isinstance(value, float)]
    rows = [
        (row["conditioning"], row["injection"], *(f"{row[figure]:.4g}" for figure in figures))
        for row in content["variants"]
    ]
    Console().print(console_table(("conditioning", "injection", *figures), rows, title, right=2))
