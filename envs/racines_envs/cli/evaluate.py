"""The command `racines eval agent`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings
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
    latency: Annotated[
        int | None, typer.Option(help="Decisions to time one at a time; 0 for none.")
    ] = None,
    name: Name = None,
    run: opt.Trained = None,
    out: opt.OwnOutFile = None,
    picture: Annotated[
        Path | None, typer.Option(help="Picture of trajectories; beside the scores, .png.")
    ] = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Score an agent from fixed starts; options override the settings.

    The policy is that of envs/runs/<run>, the scores go to envs/runs/scores/<run>.json.
    """
    import json

    from racines_data.config import fill, section
    from racines_envs.evaluation.entries import find_entry
    from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent, name)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, generator=generator, reward=reward,
        data=data, grader=grader, device=device, seed=seed, latency=latency,
    )  # fmt: skip
    config = fill(EvaluationConfig, section(settings, "evaluation") | chosen, "evaluation")
    result = evaluate(
        entry.agent,
        run or entry.folder,
        config,
        phantom_config(settings),
        run=entry.name,
        board=settings.get("board"),
    )
    out = out or entry.scores
    write_evaluation(result, out, picture or out.with_suffix(".png"))
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        _show(result.scores, out)


def _show(scores: dict[str, Any], path: Path) -> None:
    """Print the figures as a table."""
    from rich.console import Console
    from rich.table import Table

    task = scores["task"]
    table = Table(title=f"{scores['agent']} on {task['view']} ({task['observation']})")
    for column in ("figure", "value", "95 %", "n"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    for name, figure in scores["metrics"].items():
        value, low, high = (_number(figure[key]) for key in ("value", "low", "high"))
        table.add_row(name, value, f"{low} – {high}", str(figure["n"]))
    Console().print(table)
    typer.echo(f"written: {path}")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
