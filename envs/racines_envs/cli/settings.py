"""What the commands on agents share."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt

Agent = Annotated[
    str,
    typer.Argument(help="Registered agent, module:Class, or a run: of a section, or published."),
]
Name = Annotated[str | None, typer.Option(help="What to call the run; as the agent, or its entry.")]

Env = Annotated[
    str | None, typer.Option(help="replay:FOLDER, a dataset's frames in place of a phantom.")
]
Goal = Annotated[str | None, typer.Option(help="With --env, the frame to find, TRAJECTORY:FRAME.")]

Tier = opt.Tier


def on_patients(task: Any) -> str | None:
    """Return the name of a task on patients that a run was trained for; None of any other."""
    from racines_envs.task.names import HEART_TIER, tier_of

    return task if isinstance(task, str) and tier_of(task) != HEART_TIER else None


def on_tier(view: str | None, tier: str | None) -> str | None:
    """Return the name of the task of a view on a tier, as settings have it; A4C if none is said."""
    from racines_data.errors import RacinesError
    from racines_envs.task.names import HEART_TIER, TIERS

    if tier is None:
        return view
    if tier not in TIERS:
        raise RacinesError(f"unknown tier {tier!r}: choose one of {', '.join(TIERS)}")
    return view if tier == HEART_TIER else f"{view or 'A4C'}-{tier}"


def open_env(
    env: str, values: dict[str, Any], view: str | None, chosen: dict[str, Any], device: str | None
) -> tuple[Any, dict[str, Any], str]:
    """Return the world of `replay:FOLDER`, the settings that are not its own, and what to call it.

    `values` are all sections' settings, of which `replay` is the world's; `chosen` go before them.
    """
    from dataclasses import fields

    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import plain_name
    from racines_envs.worlds.recorded.opening import open_recordings
    from racines_envs.worlds.recorded.settings import ReplayConfig, read_env

    folder = read_env(env)
    known = {field.name for field in fields(ReplayConfig)}
    own = {name: value for name, value in chosen.items() if name in known}
    config = fill(ReplayConfig, section(values, "replay") | own, "replay")
    world = open_recordings(folder, view or "", config, device or "cpu")
    rest = {name: value for name, value in chosen.items() if name not in known}
    return world, rest, plain_name(f"replay-{folder.absolute().name}-{world.aim.view}")


def phantom_config(settings: dict[str, Any]) -> Any:
    """Return the configuration of the phantom that the dataset is acquired from."""
    from racines_data.config import fill, section
    from racines_data.phantom import PhantomConfig

    return fill(PhantomConfig, section(settings, "data.phantom.phantom"), "data.phantom.phantom")
