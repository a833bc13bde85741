"""The command `racines study speed`. Heavy imports stand inside, so that --help is instant."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, overrides, read_settings
from racines_envs.cli.settings import phantom_config
from racines_envs.cli.study.lists import integers
from racines_models.cli.device import OneDevice


def speed(
    view: opt.View = None,
    observation: opt.Observation = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    num_envs: Annotated[
        str | None, typer.Option(help="Batch sizes, comma-separated; 1,64.")
    ] = None,
    settings: opt.Set = None,
    threads: Annotated[int | None, typer.Option(help="CPU threads; PyTorch's default.")] = None,
    device: OneDevice = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Time an environment: steps a second, and where the time of a step goes."""
    import json

    import torch

    from racines_data.config import fill
    from racines_envs.studies.step_profile import SpeedConfig, step_speed

    values = read_settings(params, profile)
    chosen = given(
        view=view, observation=observation, reward=reward, grader=grader, backend=backend,
        generator=generator, num_envs=integers(num_envs), device=device,
    ) | overrides(settings)  # fmt: skip
    if grader is not None and reward is None:
        chosen["reward"] = "paper"
    if threads is not None:
        if threads < 1:
            raise typer.BadParameter(f"{threads} threads: give 1 or more")
        torch.set_num_threads(threads)
    content = step_speed(fill(SpeedConfig, chosen, "speed"), phantom_config(values))
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
