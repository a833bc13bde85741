"""A validation as people read it: one line a check, and the table beside the paper's."""

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from racines_data.tables import console_table
from racines_data.validate.run import Check, Validation
from racines_data.views import PAPER_STATISTICS

_KINDS = ("minimum", "maximum", "mean", "std")


def print_validation(result: Validation) -> None:
    """Print checks and statistics on stdout."""
    console = Console()
    for check in result.checks:
        line = Text.assemble(_mark(check), f"  {check.name}: {check.detail}")
        console.print(line, soft_wrap=True, highlight=False)
    if result.statistics:
        console.print(_table(result))


def _mark(check: Check) -> tuple[str, str]:
    if check.ok:
        return "ok", "green"
    return ("BROKEN", "red") if check.binding else ("note", "yellow")


def _table(result: Validation) -> Table:
    rows: list[list[str | Text]] = []
    for name, values in result.statistics.items():
        rows.append([name, *_numbers(values)])
        if name in result.verdicts:
            faults = result.verdicts[name].faults
            rows[-1].append(Text("; ".join(faults), "red") if faults else Text("holds", "green"))
            paper = ("  paper, real", *_numbers(PAPER_STATISTICS[name]))
            rows.append([Text(cell, "dim") for cell in paper])
    return console_table(("parameter", *_KINDS, *(["verdict"] if result.verdicts else [])), rows)


def _numbers(values: Any) -> list[str]:
    return [f"{getattr(values, kind):.4f}" for kind in _KINDS]
