"""The option `--device`, as every command has it."""

from typing import Annotated

import typer


def _present(device: str | None) -> str | None:
    """Return what the name stands for; refused before anything else is looked at."""
    from racines_models.devices import resolve_device

    return None if device is None else resolve_device(device)


_HELP = "auto, cpu, cuda or cuda:N."
Device = Annotated[str, typer.Option(help=_HELP, callback=_present)]
OneDevice = Annotated[str | None, typer.Option("--device", help=_HELP, callback=_present)]
"""Where the settings name one already."""
