"""The command `racines explain`."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings
from racines_envs.cli.settings import Agent, phantom_config
from racines_models.cli.device import OneDevice


def explain(
    agent: Agent,
    view: opt.View = None,
    starts: opt.Starts = None,
    every: Annotated[int | None, typer.Option(help="Explain every n-th step's image.")] = None,
    frames: Annotated[int | None, typer.Option(help="Most images an episode; 0: all.")] = None,
    steps: Annotated[int | None, typer.Option(help="Points of the integral.")] = None,
    random_maps: Annotated[int | None, typer.Option(help="Random maps of each kind.")] = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    data: opt.OtherData = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    device: OneDevice = None,
    seed: opt.StartSeed = None,
    run: opt.Trained = None,
    out: opt.OwnOut = None,
    pictures: Annotated[int, typer.Option(help="Episodes that are drawn.")] = 4,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Show what in the images moved an agent, with scores; options override the settings.

    A grader is explained beside it. The result goes to envs/runs/explain/<run>, or --out.
    """
    import json

    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import RUNS
    from racines_envs.evaluation.entries import find_entry
    from racines_envs.explain.run import ExplainConfig, write_explanation
    from racines_envs.explain.run import explain as explain_agent

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, every=every, frames=frames, steps=steps, backend=backend,
        data=data,
        random_maps=random_maps, generator=generator, reward=reward, grader=grader,
        device=device, seed=seed,
    )  # fmt: skip
    config = fill(ExplainConfig, section(settings, "explain") | chosen, "explain")
    place = run or entry.folder
    result = explain_agent(entry.agent, place, config, phantom_config(settings))
    folder = out or RUNS / "explain" / entry.name
    write_explanation(result, folder, pictures)
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        _show(result.scores)
        typer.echo(f"written: {folder}")


def _show(scores: dict[str, Any]) -> None:
    """Print the figures as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{scores['agent']}: {scores['images']} images")
    for column in ("of", "figure", "value", "95 %"):
        table.add_column(column, justify="left" if column in ("of", "figure") else "right")
    for what, metrics in scores["metrics"].items():
        for name, figure in metrics.items():
            value, low, high = (
                "–" if figure[key] is None else f"{figure[key]:.3g}"
                for key in ("value", "low", "high")
            )
            table.add_row(what, name, value, f"{low} – {high}")
    Console().print(table)
