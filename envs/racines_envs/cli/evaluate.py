"""The command `racines eval agent`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_envs.cli.settings import Agent, Name, phantom_config
from racines_models.cli.device import OneDevice


def evaluate_agent(
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
    name: Name = None,
    run: opt.Trained = None,
    out: opt.OwnOutFile = None,
    picture: Annotated[
        Path | None, typer.Option(help="Picture of trajectories; beside the scores, .png.")
    ] = None,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Score an agent from fixed starts; options override the settings.

    The policy is that of envs/runs/<run>, the scores go to envs/runs/scores/<run>.json.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_entry
    from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
    from racines_models.cli.output import show_metrics

    values = read_settings(params, profile)
    entry = find_entry(values, agent, name)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, generator=generator, reward=reward,
        data=data, grader=grader, device=device, seed=seed,
    ) | overrides(settings)  # fmt: skip
    config = fill(EvaluationConfig, section(values, "evaluation") | chosen, "evaluation")
    phantom, board = phantom_config(values), values.get("board")
    result = evaluate(
        entry.agent, run or entry.folder, config, phantom, run=entry.name, board=board
    )
    out = out or entry.scores
    write_evaluation(result, out, picture or out.with_suffix(".png"))
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        task = result.scores["task"]
        title = f"{result.scores['agent']} on {task['view']} ({task['observation']})"
        show_metrics(title, result.scores["metrics"])
        typer.echo(f"written: {out}")
