"""Text that others wrote, made safe for where it is shown: one escape a medium, each used once.

Names, descriptions, authors, file names and labels are data. Whoever writes them into Markdown,
HTML, a CSV file or a terminal passes them through the escape of that medium, and through no other.
"""

import html as _html
import json
import re
from typing import Any

_MARKS = re.compile(r"([\\`|*\[\]])")
_EDGE = re.compile(r"(?<![^\W_])_|_(?![^\W_])")
"""An underscore that can begin or end emphasis; within a word it cannot."""
_ENTITIES = str.maketrans(
    # `~~` strikes out and fences code, `$` sets mathematics.
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", "~": "&#126;", "$": "&#36;"}
)
_ADDRESS = re.compile(r"(?<=\S)@(?=\S)")
_AUTOLINKS = re.compile(r":(?=//)|(?<=www)\.|(?<=mailto):|(?<=xmpp):", re.IGNORECASE)
"""What GitHub makes links of without being asked."""
_BLOCKS = re.compile(r"(#{1,6}(?=\s)|##|[-+](?=[\s+-]|$)|=(?=[\s=]|$)|!!!|\?\?\?|:(?=\s))")
_NUMBERED = re.compile(r"(\d{1,9})([.)])(?=\s|$)")
# Components of the Studio's pages fill templates, so their marks are text as well.
_TEMPLATES = str.maketrans({"{": "&#123;", "}": "&#125;", "$": "&#36;", "`": "&#96;"})
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_FORMULA = re.compile(r"\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")
"""How a spreadsheet's formula begins, also in the full-width forms of East Asian scripts."""


def visible(text: Any, keep: str = "") -> str:
    """Return text with a space for each character that is not seen, but for those to `keep`.

    These are control characters (line breaks and the terminal's escape among them), marks that turn
    the direction of writing, characters that no font has, and bytes of names that are no Unicode.
    """
    words = str(text)
    if words.isprintable():
        return words
    return "".join(c if c.isprintable() or c in keep else " " for c in words)


def markdown(text: Any) -> str:
    """Return text as Markdown that shows it on one line: no markup, link, HTML, cell or block."""
    line = " ".join(visible("\n".join(str(text).splitlines()), "\n").split("\n")).strip()
    line = _MARKS.sub(r"\\\1", line.translate(_ENTITIES))
    # GitHub links addresses in what it has parsed, past every escape: an empty comment stops it.
    line = _ADDRESS.sub("&#64;<!-- -->", line)
    line = _AUTOLINKS.sub(lambda found: f"&#{ord(found[0])};", _EDGE.sub(r"\\_", line))
    return _NUMBERED.sub(r"\1\\\2", line) if _NUMBERED.match(line) else _block(line)


def _block(line: str) -> str:
    return f"&#{ord(line[0])};{line[1:]}" if _BLOCKS.match(line) else line


def html(text: Any) -> str:
    """Return text as HTML that shows it on one line: no element, attribute or template."""
    return _html.escape(visible(text), quote=True).translate(_TEMPLATES)


def json_in_html(document: Any) -> str:
    """Return a document as JSON for a script's element, where nothing may look like markup.

    Neither the element's end nor a comment can stand in it; it parses to the same document.

    Raises:
        ValueError: a number that JSON does not have, such as NaN.
    """
    text = json.dumps(document, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for sign, number in (("<", "003c"), (">", "003e"), ("&", "0026")):
        text = text.replace(sign, f"\\u{number}")
    return text


def csv_cell(value: Any) -> Any:
    """Return a value for a CSV file: numbers as they are, text that no spreadsheet runs.

    An apostrophe goes before what would be taken for a formula, as OWASP advises; None is empty.
    """
    if value is None or isinstance(value, bool | int | float):
        return "" if value is None else value
    words = visible(value)
    if _NUMBER.fullmatch(words):
        return words
    return f"'{words}" if _FORMULA.match(words) or str(value)[:1] in "\t\r\n" else words
