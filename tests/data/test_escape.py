"""One escape a medium, held against what really reads it: Markdown, HTML, CSV, a terminal."""

import csv
import io
import re
from html import unescape
from html.parser import HTMLParser

import markdown as python_markdown
import polars as pl
import pytest
from markdown_it import MarkdownIt
from rich.text import Text

from racines_data import escape
from racines_data.progress import image_counter, progress_bar
from racines_data.tables import code, console_table, csv_table, markdown_table
from racines_data.terminal import console, say, say_json, say_page
from tests.hostile import ALL, CONTROLS, FORMULAS, MARKUP


class Page(HTMLParser):
    """The elements, attributes and text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.text += data


def rendered(text: str) -> list[Page]:
    """Read Markdown as GitHub nearly does, and as the documentation's tool does."""
    it = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
    extensions = ["tables", "admonition", "toc", "pymdownx.superfences", "pymdownx.highlight"]
    extensions += ["def_list", "footnotes"]
    return [Page(it.render(text)), Page(python_markdown.markdown(text, extensions=extensions))]


def plain(text: str) -> str:
    return " ".join(escape.visible(text).split())


@pytest.mark.parametrize("text", ALL)
def test_a_paragraph_of_markdown_stays_one_and_shows_the_text(text: str):
    for page in rendered(escape.markdown(text) + "\n"):
        assert page.tags in (["p"], []) and not page.attributes
        assert " ".join(page.text.split()) == plain(text)


@pytest.mark.parametrize("text", ALL)
def test_a_cell_of_markdown_stays_one(text: str):
    for cell in (text, code(text)):
        for page in rendered(markdown_table(("a", "b"), [(cell, "end"), ("x", "y")]) + "\n"):
            tags = [tag for tag in page.tags if tag != "code"]
            assert tags == [
                "table",
                "thead",
                "tr",
                "th",
                "th",
                "tbody",
                "tr",
                "td",
                "td",
                "tr",
                "td",
                "td",
            ]
            assert not page.attributes and "end" in page.text


@pytest.mark.parametrize("text", MARKUP)
def test_nothing_that_github_links_by_itself_is_left(text: str):
    """Its rules: https://github.github.com/gfm/#autolinks-extension- (tried with cmark-gfm)."""
    shown = escape.markdown(text)
    assert not re.search(r"(?i)://|www\.|\S@\S|mailto:|xmpp:", shown)


@pytest.mark.parametrize("text", ALL)
def test_html_shows_the_text_and_no_more(text: str):
    page = Page(f'<p title="{escape.html(text)}">{escape.html(text)}</p>')
    assert page.tags == ["p"] and [name for name, _ in page.attributes] == ["title"]
    assert page.text == page.attributes[0][1] == escape.visible(text)
    assert not set(escape.html(text)) & set("<>\"'{}$`")


def test_nothing_is_escaped_twice():
    assert escape.visible(escape.visible("a\x1bb")) == "a b"
    assert unescape(escape.html("a & b < c")) == "a & b < c"
    table = markdown_table(("a",), [("R&D | <b>",)])
    assert table.count("&amp;") == 1 and "&amp;amp;" not in table


@pytest.mark.parametrize(
    "text", ["plain", "a_b.c", "SSIM ↑", "0.5 (0.4 – 0.6), n = 3", "Zürich 心臓", "−3"]
)
def test_what_is_harmless_stays_as_it_is(text: str):
    assert escape.markdown(text) == escape.visible(text) == escape.csv_cell(text) == text


def test_no_cell_of_a_csv_file_is_a_formula():
    rows = [[text, 1.5, -2, None, "-0.25", "1e-3"] for text in ALL]
    written = csv_table(("text", "a", "b", "c", "d", "e"), rows)
    tables = [list(csv.reader(io.StringIO(written)))[1:]]
    read = pl.read_csv(io.StringIO(written), infer_schema=False)
    tables.append([["" if cell is None else cell for cell in row] for row in read.iter_rows()])
    for table in tables:
        assert len(table) == len(ALL)
        for text, cells in zip(ALL, table, strict=True):
            assert cells[1:] == ["1.5", "-2", "", "-0.25", "1e-3"]
            assert not re.match(r"\s*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20]", cells[0]), text
            assert cells[0].lstrip("'") == escape.visible(text).lstrip("'")
    assert [escape.csv_cell(text)[0] for text in FORMULAS if text[0] in "=+-@\t\r"].count("'") >= 8


@pytest.mark.parametrize("text", CONTROLS)
def test_a_terminal_gets_no_control_character(text: str, capsys: pytest.CaptureFixture[str]):
    say(text)
    say(text, err=True)
    say_page(f"one\n{text.replace(chr(10), ' ')}\n")
    say_json({text.encode(errors="replace").decode(): text.encode(errors="replace").decode()})
    shown = console()
    shown.print(text)
    shown.print(Text(text, "bold"))
    shown.print(console_table((text, "n"), [(text, "1"), (Text(text, "red"), "2")], text))
    told = capsys.readouterr()
    for line in (told.out + told.err).split("\n"):
        assert line.isprintable(), line
    assert told.err.count("\n") == 1 and "\n".join(told.out.split("\n")[:1]) == escape.visible(text)
    if text.startswith("[") or text == ":smile:":
        assert told.out.count(text) >= 5, "marks of rich are text"


def test_styles_stay_where_they_were():
    from racines_data.terminal import shown_text

    text = shown_text(Text.assemble(("ok", "green"), "\x1b[31m", ("bad", "red")))
    assert text.plain == "ok [31mbad" and [(s.start, s.end) for s in text.spans] == [
        (0, 2),
        (7, 10),
    ]


def test_a_progress_bar_shows_a_name_as_text(monkeypatch: pytest.MonkeyPatch):
    from rich.console import Console

    out = io.StringIO()
    shown = Console(file=out, force_terminal=True, width=120, color_system=None)
    monkeypatch.setattr("racines_data.progress.console", lambda err: shown)
    with image_counter("[red]x[/red]\x1b]0;title\x07", 3, hidden=False) as advance:
        advance(3)
    assert "[red]x[/red] ]0;title " in out.getvalue() and "\x1b]0" not in out.getvalue()
    assert progress_bar(False).disable
