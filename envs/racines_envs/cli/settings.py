"""What the commands on agents share."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt

Agent = Annotated[
    str, typer.Argument(help="Registered agent, module:Class, or a run of the section agents.")
]
Name = Annotated[str | None, typer.Option(help="What to call the run; as the agent, or its entry.")]

Tier = opt.Tier


def on_tier(view: str | None, tier: str | None) -> str | None:
    """Return the name of the task of a view on a tier, as settings have it; A4C if none is said."""
    from racines_data.errors import RacinesError
    from racines_envs.task.names import HEART_TIER, TIERS

    if tier is None:
        return view
    if tier not in TIERS:
        raise RacinesError(f"unknown tier {tier!r}: choose one of {', '.join(TIERS)}")
    return view if tier == HEART_TIER else f"{view or 'A4C'}-{tier}"


def phantom_config(settings: dict[str, Any]) -> Any:
    """Return the configuration of the phantom that the dataset is acquired from."""
    from racines_data.config import fill, section
    from racines_data.phantom import PhantomConfig

    return fill(PhantomConfig, section(settings, "data.phantom.phantom"), "data.phantom.phantom")
