"""The commands `racines train agent` and `encoder`. Heavy imports stand inside: --help is quick."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings, seed_of
from racines_envs.cli.settings import Agent, Name, phantom_config
from racines_models.cli.device import Device, OneDevice


def train_agent(
    agent: Agent = "ppo",
    view: opt.View = None,
    observation: opt.Observation = None,
    reward: opt.Reward = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    grader: opt.Grader = None,
    encoder: Annotated[
        str | None, typer.Option(help="What looks at images: a folder, or pose.")
    ] = None,
    data: opt.OtherData = None,
    frames: Annotated[int | None, typer.Option(help="Environment steps.")] = None,
    device: OneDevice = None,
    seed: opt.Seed = None,
    name: Name = None,
    out: opt.OwnOut = None,
    resume: opt.Resume = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train an agent into envs/runs/<run>, or --out; options override the settings."""
    from racines_data.config import fill
    from racines_envs.agents import agent_class
    from racines_envs.evaluation.agent_specs import find_entry

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent, name)
    chosen = given(
        view=view, observation=observation, reward=reward, backend=backend, generator=generator,
        grader=grader, encoder=encoder, frames=frames, device=device,
    )  # fmt: skip
    cls = agent_class(entry.agent)
    config: Any = fill(cls.Config, entry.settings | chosen, entry.where)
    folder = out or entry.folder
    where = {"phantom": phantom_config(settings), "data": data, "progress": not as_json}
    cls.train(config, folder, seed=seed_of(settings, seed), resume=resume, **where)
    metrics = (folder / "metrics.json").read_text()
    typer.echo(metrics if as_json else f"settings, metrics and policy, if any, are in {folder}")


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
