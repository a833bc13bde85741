"""The one way of the commands to a terminal: what others wrote has no say over it.

A name may hold the escape that clears a screen, renames a window or hides what follows; here it is
shown as a space. `--json` is written in ASCII.
"""

import json
import os
from typing import TYPE_CHECKING, Any

import typer

from racines_data.escape import visible

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text


QUIET = "RACINES_QUIET"
"""Variable that `--quiet` sets, so that worker processes are quiet as well; 0 is as unset."""
HUSHED = ("HF_DATASETS_DISABLE_PROGRESS_BARS", "HF_HUB_DISABLE_PROGRESS_BARS")


def say(line: Any, err: bool = False) -> None:
    """Print one line, on stderr with `err`: a result, a warning or an error."""
    typer.echo(visible(line), err=err)


def note(line: Any) -> None:
    """Print one line on stderr that nobody has to read, unless `--quiet` is given."""
    if not quiet():
        say(line, err=True)


def quiet() -> bool:
    """Say whether progress and notes are left out."""
    return os.environ.get(QUIET, "0") not in ("", "0")


def be_quiet() -> None:
    """Leave out progress and notes from here on, those of the libraries that we call as well."""
    os.environ[QUIET] = "1"
    for name in HUSHED:
        os.environ[name] = "1"


def say_page(page: str) -> None:
    """Print text of several lines, whose line breaks are our own."""
    typer.echo(visible(page, keep="\n"))


def say_json(document: Any, indent: int | None = None) -> None:
    """Print JSON, in ASCII: what cannot be seen is written as its number."""
    typer.echo(json.dumps(document, indent=indent))


def shown_text(content: "str | Text") -> "Text":
    """Return text for `rich`, styled as it was, without markup or control characters."""
    from rich.text import Text

    text = Text(content) if isinstance(content, str) else content.copy()
    text.plain = visible(text.plain, keep="\n")  # one character for one, so styles stay in place
    return text


def console(err: bool = False) -> "Console":
    """Return a console that takes text as it stands; `console_table` makes its tables."""
    from rich.console import Console
    from rich.text import Text

    class Plain(Console):
        def print(self, *objects: Any, **options: Any) -> None:
            texts = (shown_text(o) if isinstance(o, str | Text) else o for o in objects)
            super().print(*texts, **options)

    return Plain(stderr=err, markup=False, emoji=False, highlight=False)


def sized(count: float) -> str:
    """Return a count of bytes in words: `950 B`, `1.2 kB`, `3.40 GB`."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.{0 if unit == 'B' else 1}f} {unit}"
        count /= 1000
    return f"{count:.2f} GB"
