"""Commands: `racines export agent` and `racines export trace`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import check_ending, given, read_settings
from racines_envs.cli.settings import phantom_config


def export_agent(
    run: Annotated[Path, typer.Argument(help="Folder that a training left, envs/runs/NAME.")],
    out: opt.OutFile,
    as_json: opt.AsJson = False,
) -> None:
    """Write a trained policy as one ONNX file, its frozen encoder inside."""
    from racines_envs.agents.onnx.policy import export_run

    check_ending(out, ".onnx")
    made = export_run(run, out)
    line = f"{out}: {made['bytes']:,} bytes, opset {made['opset']}, sees {made['observation']}"
    typer.echo(json.dumps(made) if as_json else line)


def export_trace(
    agent: Annotated[str, typer.Argument(help="Registered agent, module:Class or FILE.onnx.")],
    out: opt.OutFile,
    view: opt.View = None,
    starts: opt.Starts = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    seed: opt.StartSeed = None,
    run: opt.Trained = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write the actions that an agent takes from the fixed starts, for others to take again."""
    from racines_data.config import fill, section
    from racines_envs.agents import agent_class
    from racines_envs.evaluation.agent_specs import RUNS
    from racines_envs.evaluation.run import EvaluationConfig, record_trace

    check_ending(out, ".json")
    settings = read_settings(params, profile)
    chosen = given(view=view, starts=starts, reward=reward, grader=grader, seed=seed)
    config = fill(EvaluationConfig, section(settings, "evaluation") | chosen, "evaluation")
    folder = run or RUNS / agent_class(agent).name
    made = record_trace(agent, folder, config, out, phantom_config(settings))
    line = f"{out}: {made['episodes']:,} episodes, {made['steps']:,} steps"
    typer.echo(json.dumps(made) if as_json else line)
