"""Command: `racines export agent`."""

import json
from pathlib import Path
from typing import Annotated

import typer


def register(export: typer.Typer) -> None:
    """Add the command to the shared verb."""
    export.command("agent")(export_agent)


def export_agent(
    run: Annotated[Path, typer.Argument(help="Folder that a training left, envs/runs/NAME.")],
    out: Annotated[Path, typer.Option(help="The file to write, FILE.onnx.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
) -> None:
    """Write a trained policy as one ONNX file, its frozen encoder inside."""
    from racines_envs.agents.onnx_policy_export import export_run

    if out.suffix.lower() != ".onnx":
        raise typer.BadParameter(f"{out}: end the name with .onnx", param_hint="--out")
    made = export_run(run, out)
    line = f"{out}: {made['bytes']:,} bytes, opset {made['opset']}, sees {made['observation']}"
    typer.echo(json.dumps(made) if as_json else line)
