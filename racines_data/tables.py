"""Tables: one writer of Markdown, with one escape of what others wrote, and one of the terminal's.

A cell is text, shown as it stands, unless it says that it is `Markdown` (or rich's `Text`) of ours.
"""

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

_MARKS = re.compile(r"([\\`|*\[\]])")
_HTML = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


class Markdown(str):
    """A cell that is Markdown of our own, and never what somebody handed in."""


def code(text: Any) -> Markdown:
    """Return text in code letters."""
    line = " ".join(str(text).replace("`", "'").replace("|", "\\|").splitlines())
    return Markdown(f"`{line}`")


def escape(text: Any) -> str:
    """Return text as Markdown that shows it on one line: no markup, HTML, cell or line break."""
    line = " ".join(str(text).splitlines())
    return _MARKS.sub(r"\\\1", line.translate(_HTML))


def markdown_table(
    head: Sequence[Any], rows: Iterable[Sequence[Any]], right: int | None = None
) -> str:
    """Return a Markdown table; the columns from `right` on are aligned to the right."""
    rule = ["---" if right is None or i < right else "---:" for i in range(len(head))]
    lines = [head, [Markdown(mark) for mark in rule], *rows]
    cells = ((c if isinstance(c, Markdown) else escape(c) for c in line) for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def console_table(
    head: Sequence[str],
    rows: Iterable[Iterable["str | Text"]],
    title: str | None = None,
    right: int | None = 1,
    padding: int = 1,
) -> "Table":
    """Return a table for `rich.print`; the columns from `right` on are aligned to the right.

    Cells that are text are shown as they stand: `[red]` is no colour.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    named = None if title is None else Text(title)
    table = Table(title=named, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, padding))
    for i, name in enumerate(head):
        justify = "left" if right is None or i < right else "right"
        table.add_column(Text(name), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return table
