"""The command `racines explain`."""

import json
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, overrides, read_settings
from racines_envs.cli.settings import Agent, phantom_config
from racines_models.cli.device import OneDevice


def explain(
    agent: Agent,
    view: opt.View = None,
    starts: opt.Starts = None,
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
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Show what in the images moved an agent, with scores; options override the settings.

    A grader is explained beside it. The result goes to envs/runs/explain/<run>, or --out.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import RUNS
    from racines_envs.evaluation.entries import find_entry
    from racines_envs.explain.explanation import write_explanation
    from racines_envs.explain.run import ExplainConfig
    from racines_envs.explain.run import explain as explain_agent
    from racines_models.cli.output import show_metrics

    values = read_settings(params, profile)
    entry = find_entry(values, agent)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, data=data, generator=generator, reward=reward,
        grader=grader, device=device, seed=seed,
    ) | overrides(settings)  # fmt: skip
    config = fill(ExplainConfig, section(values, "explain") | chosen, "explain")
    place = run or entry.folder
    result = explain_agent(entry.agent, place, config, phantom_config(values))
    folder = out or RUNS / "explain" / entry.name
    write_explanation(result, folder, pictures)
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        for what, metrics in result.scores["metrics"].items():
            show_metrics(
                f"{result.scores['agent']}, {what}: {result.scores['images']} images", metrics
            )
        typer.echo(f"written: {folder}")
