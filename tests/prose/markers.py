"""Markers in Markdown pages, whose figures are drawn from result files that are committed.

A marker stands around what it draws, and no reader of the page sees it:

    <!--n TEMPLATE-->what is drawn<!--/n-->        within a line, never at its beginning
    <!--assert EXPRESSION-->                       what the prose beside it rests on

A template is text with `{expression:format}`. An expression refers to figures as
`place/name#pointer`, and may calculate: `+ - * /`, comparisons, `min max mean median sum len abs
round`, with spaces around what is no part of a reference. Names may be several, with commas or `*`,
and so may what a pointer leads to; then the reference is a list. A metric stands for
its value, and `.low`, `.high`, `.n` follow it. A format is Python's; `%.1f` is per cent, what is
not there is drawn as –, and `{…:%.1f % (–)}` draws unit and interval: 96.3 % (93.6–97.9).

A marker whose template begins on a line of its own draws a block. There `for a b in x:y z:w` draws
the line after it once an item, with $a and $b replaced, and `table place/name#pointer` draws
`columns` and `rows` as they are kept in a file; `weightings BOARD TRACK` draws what
`racines study weightings` says.
"""

import ast
import json
import operator
import re
import statistics
from collections.abc import Callable
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import yaml

from racines_data.tables import Markdown, markdown_table

ROOT = Path(__file__).parents[2]
RECORDS = "leaderboard/results/{board}/{track}/{name}.json"
PLACES = {
    "results": "docs/results/{name}.json",
    "agents": RECORDS.format(board="phantom-reference", track="agents", name="{name}"),
    "generators": RECORDS.format(board="phantom-reference", track="generators", name="{name}"),
    "default-agents": RECORDS.format(board="phantom-default", track="agents", name="{name}"),
    "default-generators": RECORDS.format(
        board="phantom-default", track="generators", name="{name}"
    ),
    "patients": RECORDS.format(board="patients", track="patient-agents", name="{name}"),
    "adapting": RECORDS.format(board="patients", track="patient-generators", name="{name}"),
    "motion": RECORDS.format(board="trackerless", track="motion", name="{name}"),
    "tracked-motion": RECORDS.format(
        board="trackerless-tracked", track="tracked-motion", name="{name}"
    ),
    "turn-motion": RECORDS.format(board="trackerless-rotation", track="turn-motion", name="{name}"),
    "beating": RECORDS.format(board="beating", track="patient-agents", name="{name}"),
    "weights": "models/weights/{name}/config.json",
    "policies": "envs/weights/{name}/metrics.json",
    "agent-runs": "envs/weights/{name}/config.json",
    "runs": "models/runs/{name}.json",
    "mutants": "tests/mutants/{name}.yaml",
}
"""Where the result files of a place lie; `python/module.path#NAME` is a constant of the code."""
MARKER = re.compile(r"<!--n(?P<template>[ \n](?:(?!-->).)*)-->(?P<drawn>.*?)<!--/n-->", re.DOTALL)
ASSERTION = re.compile(r"<!--assert (?P<expression>(?:(?!-->).)*)-->", re.DOTALL)
BEGINNING = re.compile(r"^[ \t]*(?:(?:[-*+>]|\d+[.)])[ \t]+)*<!--(?:n |/n)", re.MULTILINE)
"""An inline comment here begins a block of HTML, in which Markdown is not read."""
PLACEHOLDER = re.compile(r"\{([^{}:]+)(?::([^{}]*))?\}")
REFERENCE = re.compile(r"(?<![\w/])([a-z][a-z-]*)/([\w.*,/+-]+)#([\w.*/+-]+)")
SPEC = re.compile(r"(?P<number>%?[+,]?(?:\.\d+)?[a-z]?)(?P<unit>.*?) \((?P<between>[^()]*)\)")
"""A format with unit and interval."""
FOR = re.compile(r"for ([\w ]+) in (.+)")
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "min": min,
    "max": max,
    "sum": sum,
    "len": len,
    "abs": abs,
    "round": round,
    "mean": statistics.fmean,
    "median": statistics.median,
}
OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


class NoFigure(Exception):
    """A marker that cannot be drawn, or a claim that does not hold; says where and why."""


@cache
def _document(path: Path) -> Any:
    if not path.is_file():
        raise NoFigure(f"no result file {path}")
    text = path.read_text(encoding="utf-8")
    content = yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text)
    if isinstance(content, dict) and "scores" in content and "track" in content:
        # A record is asked for its metrics by their names.
        return content | content["scores"] | content["scores"]["metrics"]
    if isinstance(content, dict) and content.get("schema") == "racines.figures/1":
        return content | content.get("figures", {}) | content.get("tables", {})
    return content


def _look_up(content: Any, keys: list[str]) -> Any:
    """Follow keys into a document; `*` is a list of what all keys here lead to."""
    if not keys:
        return content["value"] if isinstance(content, dict) and "value" in content else content
    key, *rest = keys
    if key == "*":
        parts = content.values() if isinstance(content, dict) else content
        found = [_look_up(part, rest) for part in parts]
        return [x for part in found for x in (part if isinstance(part, list) else [part])]
    while isinstance(content, dict) and key not in content and rest:
        key, *rest = f"{key}.{rest[0]}", *rest[1:]  # a file's name is one key, dots and all
    try:
        return _look_up(content[int(key)] if isinstance(content, list) else content[key], rest)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise NoFigure(f"nothing at {key!r}") from error


def figure(place: str, names: str, pointer: str, root: Path = ROOT) -> Any:
    """Return what `place/names#pointer` refers to: one figure, or a list for several names.

    Raises:
        NoFigure: If there is no such place, file or figure.
    """
    if place == "python":
        return resolve_name(f"{names}:{pointer}")
    if place not in PLACES:
        raise NoFigure(f"no place {place!r}; there are {', '.join(PLACES)}")
    pattern = PLACES[place]
    found = []
    for name in names.split(","):
        paths = sorted(root.glob(pattern.format(name=name))) if "*" in name else []
        if "*" in name and not paths:
            raise NoFigure(f"no result file {pattern.format(name=name)}")
        for path in paths or [root / pattern.format(name=name)]:
            try:
                found.append(_look_up(_document(path), pointer.split(".")))
            except NoFigure as error:
                raise NoFigure(f"{place}/{name}#{pointer}: {error}") from error
    return found if "," in names or "*" in names else found[0]


def evaluate(expression: str, root: Path = ROOT) -> Any:
    """Return the value of an expression over figures.

    Raises:
        NoFigure: If it is none, or a figure is not there.
    """
    values: dict[str, Any] = {}

    def name_it(found: re.Match[str]) -> str:
        name = f"figure_{len(values)}"
        values[name] = figure(*found.groups(), root=root)
        return name

    text = REFERENCE.sub(name_it, expression.strip())

    def value(node: ast.AST) -> Any:
        match node:
            case ast.Expression(body=body):
                return value(body)
            case ast.Constant(value=int() | float() | str()):
                return node.value
            case ast.Name(id=name) if name in values:
                return values[name]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
                return OPERATORS[type(op)](value(left), value(right))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -value(operand)
            case ast.BoolOp(op=ast.And(), values=parts):
                return all(value(part) for part in parts)
            case ast.Compare(left=left, ops=ops, comparators=rest):
                sides = [value(side) for side in (left, *rest)]
                pairs = zip(ops, sides, sides[1:], strict=False)
                return all(OPERATORS[type(op)](a, b) for op, a, b in pairs)
            case ast.Call(func=ast.Name(id=name), args=given, keywords=[]) if name in FUNCTIONS:
                return FUNCTIONS[name](*map(value, given))
        raise NoFigure(f"{expression!r} is no expression over figures")

    try:
        return value(ast.parse(text, mode="eval"))
    except (SyntaxError, TypeError, KeyError, ZeroDivisionError) as error:
        raise NoFigure(f"{expression!r}: {error}") from error


def _shown(expression: str, spec: str | None, root: Path) -> str:
    value = evaluate(expression, root)
    if value is None:
        return "–"
    if spec and (whole := SPEC.fullmatch(spec)):
        if not REFERENCE.fullmatch(expression):
            raise NoFigure(f"{expression!r} is not one metric, and has no interval")
        low, high = (
            _shown(f"{expression}.{end}", whole["number"], root) for end in ("low", "high")
        )
        mean = _shown(expression, whole["number"], root)
        return f"{mean}{whole['unit']} ({low}{whole['between']}{high})"
    if not spec:
        return str(value)
    scale, spec = (100, spec[1:]) if spec.startswith("%") else (1, spec)
    try:
        return format(value * scale if scale != 1 else value, spec)
    except (TypeError, ValueError) as error:
        raise NoFigure(f"{expression!r} as {spec!r}: {error}") from error


def _fill(text: str, root: Path) -> str:
    return PLACEHOLDER.sub(lambda found: _shown(found[1], found[2], root), text)


def _block(template: str, root: Path) -> str:
    drawn, lines = [], template.strip("\n").split("\n")
    while lines:
        line = lines.pop(0)
        if line.startswith("table "):
            table = evaluate(line.removeprefix("table "), root)
            head, *rows = ([Markdown(c) for c in r] for r in (table["columns"], *table["rows"]))
            drawn.append(markdown_table(head, rows, table.get("right")))
        elif line.startswith("weightings "):
            drawn.append(_weightings(*line.split()[1:], root))
        elif loop := FOR.fullmatch(line):
            row, names = lines.pop(0), loop[1].split()
            for item in loop[2].split():
                filled = row
                for name, word in zip(names, item.split(":"), strict=True):
                    filled = re.sub(rf"\${name}\b", lambda _, word=word: word, filled)
                drawn.append(_fill(filled, root))
        else:
            drawn.append(_fill(line, root))
    return "\n\n" + "\n".join(drawn) + "\n\n"


def _weightings(board: str, track: str, root: Path) -> str:
    """Return the table of a board's order under other weights of its metrics."""
    from racines_leaderboard.board.table import titled_markdown
    from racines_leaderboard.board.weightings import tables

    found = tables(root / "leaderboard/results", board)
    return "\n\n".join(titled_markdown(each) for each in found if f"· {track} ·" in each.title)


def drawn(template: str, root: Path = ROOT) -> str:
    """Return what a template draws."""
    if template.startswith("\n"):
        return _block(template, root)
    return _fill(template.strip(), root)


def redrawn(page: str, name: str, root: Path = ROOT) -> str:
    """Return a page with every marker drawn anew; what is drawn already stays to the byte.

    Args:
        page: Markdown.
        name: Of the page, for messages.
        root: The repository.

    Raises:
        NoFigure: With each marker that cannot be drawn and each claim that does not hold.
    """
    faults = []

    def at(found: re.Match[str]) -> str:
        return f"{name}:{page.count(chr(10), 0, found.start()) + 1}"

    def draw(found: re.Match[str]) -> str:
        try:
            return f"<!--n{found['template']}-->{drawn(found['template'], root)}<!--/n-->"
        except NoFigure as error:
            faults.append(f"{at(found)}: {error}")
            return found[0]

    for found in BEGINNING.finditer(MARKER.sub(_without_blocks, page)):
        faults.append(f"{name}: a marker begins a line: {found[0].strip()!r}; put a word before it")
    for found in ASSERTION.finditer(page):
        try:
            if evaluate(found["expression"], root) is not True:
                faults.append(f"{at(found)}: no longer true: {found['expression']}")
        except NoFigure as error:
            faults.append(f"{at(found)}: {error}")
    result = MARKER.sub(draw, page)
    left = MARKER.sub("", page)
    if re.search(r"<!--n[ \n]|<!--/n-->", left):
        faults.append(f"{name}: a marker without its end, or an end without its marker")
    if faults:
        raise NoFigure("\n".join(faults))
    return result


def _without_blocks(found: re.Match[str]) -> str:
    return "" if found["template"].startswith("\n") else found[0]


def pages(root: Path = ROOT) -> list[Path]:
    """Return the pages whose figures are looked after, those that commands write left out."""
    named = [root / "README.md", root / "CHANGELOG.md", root / "CONTRIBUTING.md"]
    named += [root / folder / "README.md" for folder in ("data", "models", "envs", "leaderboard")]
    return [*named, *sorted((root / "docs").glob("*.md"))]


def redraw(root: Path = ROOT) -> list[Path]:
    """Draw all pages anew; return those that changed. Nothing is written if anything is wrong."""
    faults, changed = [], {}
    for path in pages(root):
        text = path.read_text()
        try:
            new = redrawn(text, str(path.relative_to(root)), root)
        except NoFigure as error:
            faults.append(str(error))
            continue
        if new != text:
            changed[path] = new
    if faults:
        raise NoFigure("\n".join(faults))
    for path, new in changed.items():
        path.write_text(new)
    return list(changed)
