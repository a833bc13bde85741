"""The pieces of a page: text, links, tables, notices and pictures, as HTML.

What others wrote is shown as it stands, and never taken for markup. Pictures are part of the page,
so no file is written that another visitor could fetch.
"""

import base64
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from racines_data import escape
from racines_data.files import image_bytes
from racines_data.plotting import card_style, encode

LONGEST = 400
"""Characters of a text that are shown, unless told otherwise."""
DPI = 180
"""Of figures: about twice a screen's, so that their text stays sharp."""
_URL = re.compile(r"https://[A-Za-z0-9.-]+(:\d{1,5})?(/[A-Za-z0-9._~/?#=&%+@:,-]*)?")
_drawing = threading.Lock()
"""Matplotlib's settings belong to the process: one figure at a time."""


class Markup(str):
    """HTML of our own, where text is expected."""


def text(value: Any, longest: int = LONGEST) -> str:
    """Return a value as HTML text: escaped, without invisible characters, cut at `longest`."""
    return escape.html(cut(str(value)[: 4 * longest], longest))


def cut(words: str, longest: int) -> str:
    """Return words, an ellipsis in place of what is too long."""
    return words if len(words) <= longest else f"{words[: longest - 1]}…"


def note(words: str) -> str:
    """Return a remark."""
    return f'<p class="rc-note">{text(words)}</p>'


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
    """Return a table, which scrolls where it is too wide; cells are text unless they are `Markup`.

    `css` has a class for each column, `names` what each row tells a script that it was clicked as.
    """

    def line(tag: str, cells: Sequence[Any]) -> str:
        opened = (f'{tag} class="{name}"' if name else tag for name in css)
        shown = (cell if isinstance(cell, Markup) else text(cell) for cell in cells)
        return "".join(f"<{o}>{cell}</{tag}>" for o, cell in zip(opened, shown, strict=True))

    lines = [line("td", row) for row in rows]
    names = [""] * len(lines) if names is None else [f' data-name="{text(n)}"' for n in names]
    body = "".join(f"<tr{name}>{row}</tr>" for name, row in zip(names, lines, strict=True))
    top = f"<thead><tr>{line('th', head)}</tr></thead>"
    # What scrolls takes the focus, so that arrow keys move it.
    return f'<div class="rc-scroll" tabindex="0"><table>{top}<tbody>{body}</tbody></table></div>'


def missing(what: str, *commands: str) -> str:
    """Say what is missing and which commands make it."""
    lines = "".join(f"<p><code>{text(command)}</code></p>" for command in commands)
    return f'<div class="rc-note rc-missing"><p>{text(what)}</p>{lines}</div>'


def drawn(size: tuple[float, float], draw: Callable[[Figure], None]) -> tuple[bytes, Figure]:
    """Let `draw` fill a figure, of a size in inches, in the house style; return its PNG and it."""
    with _drawing, card_style():
        figure = Figure(figsize=size)
        draw(figure)
        figure.set_dpi(DPI)
        return encode(figure), figure


def quick_png(image: Image.Image) -> bytes:
    """Return a picture as PNG, packed lightly: a step must not wait for its smallest file."""
    return image_bytes(image, compress_level=1)


def element(png: bytes, alt: str, css: str = "rc-chart") -> str:
    """Return a PNG as an HTML image; `css` is ours, `alt` may be anybody's."""
    data = base64.b64encode(png).decode()
    return f'<img class="{css}" alt="{text(alt)}" src="data:image/png;base64,{data}">'


def animation(webp: bytes, alt: str, css: str = "rc-chart") -> str:
    """Return an animated WebP as an HTML image."""
    data = base64.b64encode(webp).decode()
    return f'<img class="{css}" alt="{text(alt)}" src="data:image/webp;base64,{data}">'


def ultrasound(png: bytes, alt: str) -> str:
    """Return an ultrasound image as HTML, on black, as large as its place allows."""
    return f'<div class="rc-scan">{element(png, alt, "rc-frame")}</div>'
