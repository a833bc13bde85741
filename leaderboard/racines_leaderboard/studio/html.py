"""The pieces of a page: text, links, tables and notices, as HTML.

What others wrote is shown as it stands, and never taken for markup.
"""

import html
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Any

from racines_data.errors import RacinesError

LONGEST = 400
"""Characters of a text that are shown, unless told otherwise."""
# The page's components fill templates, so their marks are text as well, not only HTML's own.
_MARKS = str.maketrans({"{": "&#123;", "}": "&#125;", "$": "&#36;", "`": "&#96;"})
_URL = re.compile(r"https://[A-Za-z0-9.-]+(:\d{1,5})?(/[A-Za-z0-9._~/?#=&%+@:,-]*)?")


class Markup(str):
    """A cell that is HTML of our own."""


def text(value: Any, longest: int = LONGEST) -> str:
    """Return a value as HTML text: escaped, without invisible characters, cut at `longest`."""
    visible = "".join(c if _visible(c) else " " for c in str(value)[: 4 * longest])
    cut = visible if len(visible) <= longest else f"{visible[: longest - 1]}…"
    return html.escape(cut, quote=True).translate(_MARKS)


def link(url: Any) -> str:
    """Return an https address as a link that tells the other side nothing; others as text."""
    shown = text(url)
    if not isinstance(url, str) or len(url) > LONGEST or not _URL.fullmatch(url):
        return shown
    return f'<a href="{shown}" target="_blank" rel="noopener noreferrer nofollow">{shown}</a>'


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[Any]],
    css: Sequence[str],
    names: Iterable[str] | None = None,
) -> str:
    """Return a table, which scrolls where it is too wide.

    Args:
        head: Titles of the columns.
        rows: Their cells, text unless they are `Markup`.
        css: A class for each column.
        names: What each row tells a script that it was clicked as.
    """

    def line(tag: str, cells: Sequence[Any]) -> str:
        opened = (f'{tag} class="{name}"' if name else tag for name in css)
        pairs = zip(opened, cells, strict=True)
        return "".join(f"<{opening}>{_html(cell)}</{tag}>" for opening, cell in pairs)

    lines = [f"{line('td', row)}</tr>" for row in rows]
    openings = ["<tr>"] * len(lines) if names is None else [_named(name) for name in names]
    body = "".join(a + b for a, b in zip(openings, lines, strict=True))
    top = f"<thead><tr>{line('th', head)}</tr></thead>"
    return f'<div class="rc-scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def missing(what: str, *commands: str) -> str:
    """Say what is missing and which commands make it."""
    lines = "".join(f"<p><code>{text(command)}</code></p>" for command in commands)
    return f'<div class="rc-note rc-missing"><p>{text(what)}</p>{lines}</div>'


def refusal(error: RacinesError) -> str:
    """Return a refused input's reason."""
    return f'<p class="rc-refused" role="alert">{text(error)}</p>'


def _html(cell: Any) -> str:
    return cell if isinstance(cell, Markup) else text(cell)


def _named(name: str) -> str:
    return f'<tr data-name="{text(name)}">'


def _visible(character: str) -> bool:
    """Tell text from control, format (direction changes among them) and private characters."""
    return unicodedata.category(character)[0] != "C"
