"""One way to a terminal, one writer a format: no code of the packages goes past them."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.hostile import CONTROLS

PACKAGES = ("racines_data", "models/racines_models", "envs/racines_envs")
PACKAGES += ("leaderboard/racines_leaderboard",)
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
TERMINAL = "racines_data/terminal.py"
ALONE = "envs/racines_envs/apis/lerobot/to_onnx.py"
"""Runs in LeRobot's environment, where nothing of ours need be."""
OWN_SCREEN = "envs/racines_envs/driving/keyboard.py"
"""`racines drive` paints its screen, cursor and colours; words on it are made visible there."""
ECHOES = {"typer.echo", "typer.secho", "click.echo", "click.secho", "rich.print", "os.write"}
STREAMS = {"sys.stdout", "sys.stderr", "sys.__stdout__", "sys.__stderr__"}
HTML = re.compile(r"</[a-z]|<(?:img|rect|line|circle|polyline|path|br|input)\b")
MARKDOWN = re.compile(r"(?:^|\n)(?:\||#{1,6} |!\[|- \0)|\]\(\0|\*\*\0")
SAFE = ("racines_data.escape", "racines_data.tables", "racines_leaderboard.studio.html")


parsed = cache(ast.parse)


def dotted(node: ast.AST) -> str:
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=value, attr=attr):
            return f"{dotted(value)}.{attr}"
    return ""


def writes(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of what writes to a terminal by itself."""
    tree = parsed(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and (name := dotted(node.func)):
            if name in ECHOES or name.split(".")[-1] == "Console" or name == "print":
                yield node.lineno, name
        elif isinstance(node, ast.Attribute) and dotted(node) in STREAMS:
            yield node.lineno, dotted(node)
        elif isinstance(node, ast.ImportFrom):
            taken = {alias.name for alias in node.names}
            if node.module in ("typer", "click", "sys") and taken & {"echo", "secho", "stdout"}:
                yield node.lineno, f"from {node.module} import"
        elif isinstance(node, ast.Constant) and node.value == "/dev/tty":
            yield node.lineno, "/dev/tty"


def filled_texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of each f-string that is filled in; \\0 stands for what fills it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = (v.value if isinstance(v, ast.Constant) else "\0" for v in node.values)
            text = "".join(map(str, parts))
            if "\0" in text:
                yield node.lineno, text


def imported(tree: ast.Module) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def unescaped(source: str) -> list[tuple[int, str]]:
    """Return the Markdown and HTML of a module that fills in text and has no escape."""
    tree = parsed(source)
    if imported(tree) & set(SAFE):
        return []
    found = filled_texts(tree)
    return [(line, text) for line, text in found if HTML.search(text) or MARKDOWN.search(text)]


def csv_written(source: str) -> list[int]:
    names = ("csv.writer", "csv.DictWriter", "html.escape", "markupsafe.escape")
    calls = (n for n in ast.walk(parsed(source)) if isinstance(n, ast.Call))
    return [
        n.lineno
        for n in calls
        if dotted(n.func) in names or dotted(n.func).endswith((".write_csv", ".to_csv"))
    ]


def test_only_the_terminals_module_writes_to_a_terminal():
    found = [
        f"{name}:{line}: {what}"
        for name, path in ((str(path.relative_to(ROOT)), path) for path in FILES)
        if name not in (TERMINAL, ALONE)
        for line, what in writes(path.read_text())
        if not (what == "os.write" and name == OWN_SCREEN)
    ]
    assert not found, "say it with racines_data.terminal:\n" + "\n".join(found)


def test_who_fills_markdown_or_html_escapes_it():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text!r}"
        for path in FILES
        if path.name != "html.py"  # its own elements; held by a parser in test_escape.py
        for line, text in unescaped(path.read_text())
    ]
    assert not found, "use racines_data.escape or racines_data.tables:\n" + "\n".join(found)


def test_one_writer_of_csv_and_one_escape_of_html():
    # DVCLive's layout has tables of its own kind, to which a row is added at a time.
    own = {"racines_data/tables.py", "racines_data/escape.py"}
    own.add("models/racines_models/training/curves.py")
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in FILES
        if str(path.relative_to(ROOT)) not in own
        for line in csv_written(path.read_text())
    ]
    assert not found, "use racines_data.tables.csv_table:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "print(name)",
        "import sys\nsys.stdout.write(name)",
        "import typer\ntyper.echo(name)",
        "from typer import echo\necho(name)",
        "import rich\nrich.print(name)",
        "from rich import print\nprint(name)",
        "from rich.console import Console\nConsole().print(name)",
        "import os\nos.write(1, name)",
        "open('/dev/tty', 'w')",
        "def f():\n    import sys\n    return sys.__stderr__",
    ],
)
def test_each_way_past_is_seen(line: str):
    assert list(writes(line))


def test_what_is_no_way_past_is_left_alone():
    assert not list(writes("shown.print(name)\nsay(name)\n'print(x)'"))
    assert not list(writes("from rich.console import Console\ndef f(c: Console): c.print(1)"))
    assert unescaped("f'# {name}'") and unescaped("f'<b>{name}</b>'") and unescaped("f'[a]({x})'")
    assert not unescaped("f'{a} < {b}'") and not unescaped("'# heading'")
    assert csv_written("import csv\ncsv.writer(out)") and csv_written("frame.write_csv(path)")
    assert not csv_written("import csv\ncsv.reader(file)")


def test_words_on_the_screen_of_the_keyboard_are_made_visible():
    from racines_envs.driving.keyboard import screen

    class Hostile:
        def words(self) -> list[str]:
            return list(CONTROLS)

        def picture(self) -> np.ndarray:
            return np.zeros((540, 960, 3), dtype=np.uint8)

    lines = screen(cast(Any, Hostile()), 120, 200).split("\x1b[K\r\n")[-len(CONTROLS) - 1 : -1]
    assert len(lines) == len(CONTROLS) and all(line.isprintable() for line in lines)


def test_the_packages_are_looked_through():
    assert len(FILES) > 200 and Path(ROOT / TERMINAL) in FILES
