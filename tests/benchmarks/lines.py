"""The table of peers: its lines, the file that keeps them, and how it is shown.

A line is one piece of work, done by us and by a peer in the same run, and kept only after what both
gave was compared: before either is timed, or where that would take as long again (steps, Fréchet
distance, build), what the timed rounds gave. Where they cannot be equal, the line says what is.
`make bench` measures all of them and writes `docs/speed.json`; of a run of a few benchmarks only
theirs are replaced.
"""

import json
import os
import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_models.provenance import environment
from tests.benchmarks.turns import Times, rate, ratios

FILE = Path(__file__).parents[2] / "docs/speed.json"
SCHEMA = "racines.speed/1"
PACKAGES = ("torch", "gymnasium", "torchrl", "datasets", "torchmetrics", "scipy", "numpy",
            "stable-baselines3", "onnxruntime")  # fmt: skip


@dataclass(frozen=True)
class Line:
    """What a piece of work takes us and a peer."""

    work: str
    unit: str
    """Of `ours` and `theirs`, such as frames/s; more is better."""
    ours: float
    peer: str
    theirs: float
    ratio: float
    """Ours in units of the peer's: the median over the rounds."""
    low: float
    high: float
    """Of the rounds' ratios."""
    rounds: int
    equal: str
    """What was asserted to be equal, or what stands in its place."""
    aim: float | None = None
    """Least ratio that the project wants."""


def line_of(
    work: str, unit: str, items: float, times: Times, peer: str, equal: str,
    aim: float | None = None, ours: str = "ours",
) -> Line:  # fmt: skip
    """Return the line of two sides that did `items` of some unit in each round."""
    each = ratios(times[peer], times[ours])
    return Line(
        work, unit, rate(items, times[ours]), peer, rate(items, times[peer]),
        statistics.median(each), min(each), max(each), len(each), equal, aim,
    )  # fmt: skip


def keep(lines: Iterable[Line], path: Path = FILE) -> dict[str, Any]:
    """Write lines in the place of those of the same work and peer, and of what machine they are."""
    here = environment() | {"cores": len(os.sched_getaffinity(0))}
    here |= {"date": date.today().isoformat()}
    here["versions"] = {name: version(name) for name in PACKAGES}
    kept = {}
    if path.is_file():
        kept = {
            (each["work"], each["peer"]): each
            for each in json.loads(path.read_text(encoding="utf-8"))["lines"]
        }
    for line in lines:
        kept[line.work, line.peer] = asdict(line) | {"measured": here}
    document = {"schema": SCHEMA, "command": "make bench", "lines": [kept[key] for key in kept]}
    write_json(path, document)
    return document


def read(path: Path = FILE) -> list[dict[str, Any]]:
    """Return the lines of a file, none where it is missing."""
    return json.loads(path.read_text(encoding="utf-8"))["lines"] if path.is_file() else []


def table(lines: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Return lines as a table of columns and rows, as the documentation takes it."""
    columns = ["work", "ours", "peer", "its", "times as quick: least – median – most", "aim",
               "equal"]  # fmt: skip
    rows = [
        [
            each["work"], f"{number(each['ours'])} {each['unit']}", each["peer"],
            number(each["theirs"]),
            " – ".join(times(each[key]) for key in ("low", "ratio", "high")),
            "–" if each["aim"] is None else f"{each['aim']:g}", each["equal"],
        ]
        for each in lines
    ]  # fmt: skip
    return {"columns": columns, "rows": rows}


def number(value: float) -> str:
    """Return a figure to three digits, thousands apart."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def times(value: float) -> str:
    """Return a ratio to two digits or so."""
    return f"{value:,.0f}" if value >= 10 else f"{value:.2f}"


def measured(lines: list[dict[str, Any]]) -> str:
    """Return on what machine, and when, lines were measured, in words."""
    here = {
        f"{each['cpu']}, {each['cores']} cores, {each['threads']} threads, torch {each['torch']}, "
        f"{each['date']}"
        for each in (line["measured"] for line in lines)
    }
    return "; ".join(sorted(here)) or "nothing yet"


PEERS, MEASURED = table(read()), measured(read())
"""What the documentation shows."""
