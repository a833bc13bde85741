"""A progress bar on stderr, shown to a person and to nobody else."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import track as rich_track

T = TypeVar("T")


def track(items: Sequence[T], description: str, shown: bool) -> Iterable[T]:
    """Yield the items; show how far that is if wanted and if stderr is a terminal."""
    console = Console(stderr=True)
    hidden = not (shown and console.is_terminal)
    return rich_track(items, description, console=console, disable=hidden)
