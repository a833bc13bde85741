"""One writer of tables, and one escape: what others wrote is shown as it stands."""

import io

import pytest
from rich.console import Console
from rich.text import Text

from racines_data.tables import Markdown, code, console_table, escape, markdown_table


def test_numbers_stand_to_the_right():
    assert markdown_table(("a", "b"), [(1, 2)]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"
    assert markdown_table("ab", [(1, 2)], right=1).splitlines()[1] == "| --- | ---: |"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a | b", r"a \| b"),
        ("a\\| b", r"a\\\| b"),
        ("[site](https://a.b)", r"\[site\](https&#58;//a.b)"),
        ("![x](y)", r"!\[x\](y)"),
        ("`code`", r"\`code\`"),
        ("<script>&lt;", "&lt;script&gt;&amp;lt;"),
        ("**loud**", r"\*\*loud\*\*"),
        ("one\ntwo\u2028three\r\n| four |", r"one two three \| four \|"),
        ("0.5 (0.4 – 0.6), n = 3", "0.5 (0.4 – 0.6), n = 3"),
    ],
)
def test_what_others_wrote_stays_in_its_cell(text, shown):
    assert escape(text) == shown
    table = markdown_table(("name", "n"), [(text, 1)])
    assert table.splitlines() == ["| name | n |", "| --- | --- |", f"| {shown} | 1 |"]


def test_markdown_of_our_own_is_put_in_as_it_is():
    assert markdown_table([Markdown("**a**"), code("b|`c")], []).startswith("| **a** | `b\\|'c` |")


def test_a_terminal_shows_marks_as_text():
    console = Console(file=io.StringIO(), width=80, force_terminal=False)
    rows = [("[red]a[/red]", "[link=https://a.b]1[/link]"), (Text("b", "dim"), "2")]
    console.print(console_table(("[b]x", "y"), rows, "[i]title"))
    drawn = console.file.getvalue()
    for text in ("[red]a[/red]", "[link=https://a.b]1[/link]", "[b]x", "[i]title"):
        assert text in drawn
    x, y = (next(line for line in drawn.splitlines() if mark in line) for mark in ("[b]x", " 2"))
    assert x.index("[b]x") == y.index("b") and x.rstrip().endswith("y")
