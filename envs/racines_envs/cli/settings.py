"""What the commands on agents share."""

from typing import Annotated, Any

import typer

Agent = Annotated[
    str, typer.Argument(help="Registered agent, module:Class, or a run of the section agents.")
]
Name = Annotated[str | None, typer.Option(help="What to call the run; as the agent, or its entry.")]


def phantom_config(settings: dict[str, Any]) -> Any:
    """Return the configuration of the phantom that the dataset is acquired from."""
    from racines_data.config import fill, section
    from racines_data.phantom import PhantomConfig

    return fill(PhantomConfig, section(settings, "data.phantom.phantom"), "data.phantom.phantom")
