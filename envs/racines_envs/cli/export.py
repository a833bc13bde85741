"""Commands: `racines export agent` and `racines export trace`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_envs.cli.settings import given, phantom_config, read_settings

RUNS = Path("envs/runs")


def register(export: typer.Typer) -> None:
    """Add the commands to the shared verb."""
    export.command("agent")(export_agent)
    export.command("trace")(export_trace)


def export_agent(
    run: Annotated[Path, typer.Argument(help="Folder that a training left, envs/runs/NAME.")],
    out: Annotated[Path, typer.Option(help="The file to write, FILE.onnx.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
) -> None:
    """Write a trained policy as one ONNX file, its frozen encoder inside."""
    from racines_envs.agents.onnx.export import export_run

    if out.suffix.lower() != ".onnx":
        raise typer.BadParameter(f"{out}: end the name with .onnx", param_hint="--out")
    made = export_run(run, out)
    line = f"{out}: {made['bytes']:,} bytes, opset {made['opset']}, sees {made['observation']}"
    typer.echo(json.dumps(made) if as_json else line)


def export_trace(
    agent: Annotated[str, typer.Argument(help="Registered agent, module:Class or FILE.onnx.")],
    out: Annotated[Path, typer.Option(help="The file to write, FILE.json.")],
    view: Annotated[str | None, typer.Option(help="Target view.")] = None,
    starts: Annotated[int | None, typer.Option(help="Episodes from each start set.")] = None,
    reward: Annotated[str | None, typer.Option(help="paper, oracle or shaped.")] = None,
    grader: Annotated[str | None, typer.Option(help="Grader: run folder.")] = None,
    seed: Annotated[int | None, typer.Option(help="Names one start set, not three.")] = None,
    run_dir: Annotated[Path | None, typer.Option(help="The policy; envs/runs/<agent>.")] = None,
    params: Annotated[
        Path | None, typer.Option(help="Settings; ./params.yaml if it is there.")
    ] = None,
    profile: Annotated[str | None, typer.Option(help="Packaged settings.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
) -> None:
    """Write the actions that an agent takes from the fixed starts, for others to take again."""
    from racines_data.config import fill, section
    from racines_envs.agents import agent_class
    from racines_envs.evaluation.run import EvaluationConfig
    from racines_envs.evaluation.tracing import record_trace

    if out.suffix.lower() != ".json":
        raise typer.BadParameter(f"{out}: end the name with .json", param_hint="--out")
    settings = read_settings(params, profile)
    chosen = given(view=view, starts=starts, reward=reward, grader=grader, seed=seed)
    config = fill(EvaluationConfig, section(settings, "evaluation") | chosen, "evaluation")
    folder = run_dir or RUNS / agent_class(agent).name
    made = record_trace(agent, folder, config, out, phantom_config(settings))
    line = f"{out}: {made['episodes']:,} episodes, {made['steps']:,} steps"
    typer.echo(json.dumps(made) if as_json else line)
