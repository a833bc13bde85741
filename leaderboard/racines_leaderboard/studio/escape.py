"""Text that others wrote, on its way into a page: shown as it stands, never taken for markup."""

import html
import re
import unicodedata
from typing import Any

LONGEST = 400
"""Characters of a text that are shown, unless told otherwise."""
# The page's components fill templates, so their marks are text as well, not only HTML's own.
_MARKS = str.maketrans({"{": "&#123;", "}": "&#125;", "$": "&#36;", "`": "&#96;"})
_URL = re.compile(r"https://[A-Za-z0-9.-]+(:\d{1,5})?(/[A-Za-z0-9._~/?#=&%+@:,-]*)?")


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


def _visible(character: str) -> bool:
    """Tell text from control, format (direction changes among them) and private characters."""
    return unicodedata.category(character)[0] != "C"
