"""The one progress bar of all long work; it is drawn on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress
from rich.text import Text

from racines_data.escape import visible
from racines_data.terminal import console, quiet


class _Name(progress.ProgressColumn):
    """What is done, in bold; the name of a run or a file is no markup."""

    def render(self, task: progress.Task) -> Text:
        return Text(visible(task.description), "bold")


def progress_bar(shown: bool, unit: str = "", *more: progress.ProgressColumn) -> progress.Progress:
    """Return a progress bar with `more` columns behind it, hidden where stderr is no terminal.

    `--quiet` hides it as well. `unit` is what is counted, in the plural.
    """
    drawn_on = console(err=True)
    return progress.Progress(
        _Name(),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        *([progress.TextColumn(unit)] if unit else []),
        progress.TimeRemainingColumn(),
        *more,
        console=drawn_on,
        disable=not (shown and drawn_on.is_terminal) or quiet(),
    )


@contextmanager
def image_counter(name: str, total: int, hidden: bool) -> Iterator[Callable[[int], None]]:
    """Show a bar over `total` images; yields what advances it."""
    with progress_bar(not hidden, "images") as bar:
        task = bar.add_task(name, total=total)
        yield lambda images: bar.advance(task, images)
        bar.update(task, completed=total)
