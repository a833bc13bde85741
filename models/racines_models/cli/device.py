"""The option `--device`, as every command has it, and what `--engine` may be given beside it."""

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from racines_data.engines import Engine


def _present(device: str | None) -> str | None:
    """Return what the name stands for; refused before anything else is looked at."""
    from racines_models.devices import resolve_device

    return None if device is None else resolve_device(device)


_HELP = "auto, cpu, cuda or cuda:N."
Device = Annotated[str, typer.Option(help=_HELP, callback=_present)]
OneDevice = Annotated[str | None, typer.Option("--device", help=_HELP, callback=_present)]
"""Where the settings name one already."""


def spread(
    engine: str, address: str | None, device: str | None = None, workers: int | None = None
) -> "AbstractContextManager[Engine | None]":
    """Return the engine that a command was given; None, within it, stands for this process.

    Of `local` that is where no more than one worker is asked for.

    Raises:
        RacinesError: as `open_engine`, or a device that workers have not.
    """
    from racines_data.engines import LOCAL, open_engine
    from racines_data.errors import RacinesError

    opened = open_engine(engine, address, workers)
    if engine == LOCAL:
        return opened if (workers or 1) > 1 else nullcontext()
    if device not in (None, "cpu"):
        raise RacinesError(f"--engine {engine} works on CPUs: give --device cpu, not {device}")
    return opened
