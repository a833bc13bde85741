"""Tables: one writer of Markdown, one of CSV and one of the terminal's.

A cell is text, shown as it stands, unless it says that it is `Markdown` (or rich's `Text`) of ours.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from racines_data.escape import csv_cell, visible
from racines_data.escape import markdown as escape

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


class Markdown(str):
    """A cell that is Markdown of our own, and never what somebody handed in."""


def code(text: Any) -> Markdown:
    """Return text in code letters."""
    line = visible(text).replace("`", "'").replace("|", "\\|").strip()
    return Markdown(f"`{line}`" if line else "")


def markdown_table(
    head: Sequence[Any], rows: Iterable[Sequence[Any]], right: int | None = None
) -> str:
    """Return a Markdown table; the columns from `right` on are aligned to the right."""
    rule = ["---" if right is None or i < right else "---:" for i in range(len(head))]
    lines = [head, [Markdown(mark) for mark in rule], *rows]
    cells = ((c if isinstance(c, Markdown) else escape(c) for c in line) for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def csv_table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table as CSV (RFC 4180): numbers as they are, no cell that a spreadsheet runs."""
    out = io.StringIO()
    csv.writer(out).writerows([csv_cell(cell) for cell in row] for row in (head, *rows))
    return out.getvalue()


def console_table(
    head: Sequence[str],
    rows: Iterable[Iterable["str | Text"]],
    title: str | None = None,
    right: int | None = 1,
    padding: int = 1,
) -> "Table":
    """Return a table for `rich.print`; the columns from `right` on are aligned to the right.

    Cells that are text are shown as they stand: `[red]` is no colour, and control characters are
    spaces. A cell may have several lines.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from racines_data.terminal import shown_text

    named = None if title is None else Text(visible(title))
    table = Table(title=named, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, padding))
    for i, name in enumerate(head):
        justify = "left" if right is None or i < right else "right"
        table.add_column(Text(visible(name)), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*map(shown_text, row))
    return table
