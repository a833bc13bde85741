"""Command: `racines eval speed`."""

from typing import Annotated, Any

import typer

from racines_envs.cli.evaluate import Device, Json, Params, Profile, integers
from racines_envs.cli.settings import given, phantom_config, read_settings


def register(evaluate: typer.Typer) -> None:
    """Add the command to `racines eval`."""
    evaluate.command("speed")(speed)


def speed(
    view: Annotated[str | None, typer.Option(help="Target view; SC.")] = None,
    observation: Annotated[str | None, typer.Option(help="image, params or multimodal.")] = None,
    reward: Annotated[str | None, typer.Option(help="oracle (default), paper or shaped.")] = None,
    grader: Annotated[str | None, typer.Option(help="Folder, for `paper`.")] = None,
    backend: Annotated[str | None, typer.Option(help="phantom, generator or replay.")] = None,
    generator: Annotated[str | None, typer.Option(help="Name, folder or FILE.onnx.")] = None,
    num_envs: Annotated[
        str | None, typer.Option(help="Batch sizes, comma-separated; 1,64.")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Steps a round.")] = None,
    threads: Annotated[int | None, typer.Option(help="CPU threads; PyTorch's default.")] = None,
    device: Device = None,
    params: Params = None,
    profile: Profile = None,
    as_json: Json = False,
) -> None:
    """Time an environment: steps a second, and where the time of a step goes."""
    import json

    import torch

    from racines_data.config import fill
    from racines_envs.studies.step_profile import SpeedConfig, step_speed

    settings = read_settings(params, profile)
    chosen = given(
        view=view, observation=observation, reward=reward, grader=grader, backend=backend,
        generator=generator, num_envs=integers(num_envs), steps=steps, device=device,
    )  # fmt: skip
    if grader is not None and reward is None:
        chosen["reward"] = "paper"
    if threads is not None:
        if threads < 1:
            raise typer.BadParameter(f"{threads} threads: give 1 or more")
        torch.set_num_threads(threads)
    content = step_speed(fill(SpeedConfig, chosen, "speed"), phantom_config(settings))
    typer.echo(json.dumps(content, indent=2) if as_json else _table(content))


def _table(content: dict[str, Any]) -> str:
    """Return the figures as a Markdown table, and what the longest operations are."""
    from racines_data.tables import markdown_table
    from racines_envs.studies.step_profile import PHASES

    rows = [
        (run["num_envs"], f"{run['steps_per_second']:,.0f}")
        + tuple(f"{run['shares'][phase]:.0%}" for phase in PHASES)
        for run in content["runs"]
    ]
    lines = [markdown_table(("environments", "steps/s", *PHASES), rows, right=0)]
    for run in content["runs"]:
        named = ", ".join(f"{each['name']} {each['share']:.0%}" for each in run["operations"])
        lines.append(f"\nOperations at {run['num_envs']}: {named}")
    machine = content["machine"]
    lines.append(
        f"\n{content['view']}, {content['observation']}, reward {content['reward']}; "
        f"{machine['device']}, {machine['threads']} of {machine['cores']} cores, "
        f"torch {machine['torch']}"
    )
    return "\n".join(lines)
