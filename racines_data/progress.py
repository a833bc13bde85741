"""The one progress bar of all long work; it is drawn on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)


def progress_bar(shown: bool, unit: str = "", *more: ProgressColumn) -> Progress:
    """Return a progress bar with `more` columns behind it, hidden where stderr is no terminal.

    `unit` is what is counted, in the plural.
    """
    console = Console(stderr=True)
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        *([TextColumn(unit)] if unit else []),
        TimeRemainingColumn(),
        *more,
        console=console,
        disable=not (shown and console.is_terminal),
    )


@contextmanager
def image_counter(name: str, total: int, hidden: bool) -> Iterator[Callable[[int], None]]:
    """Show a bar over `total` images; yields what advances it."""
    with progress_bar(not hidden, "images") as bar:
        task = bar.add_task(name, total=total)
        yield lambda images: bar.advance(task, images)
        bar.update(task, completed=total)
