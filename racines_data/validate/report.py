"""A validation as people read it: one line a check, and the table beside the paper's."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

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
    table = Table("parameter")
    for kind in _KINDS:
        table.add_column(kind, justify="right")
    if result.verdicts:
        table.add_column("verdict")
    for name, values in result.statistics.items():
        row = [f"{getattr(values, kind):.4f}" for kind in _KINDS]
        if name not in result.verdicts:
            table.add_row(name, *row)
            continue
        faults = result.verdicts[name].faults
        verdict = Text("; ".join(faults), "red") if faults else Text("holds", "green")
        table.add_row(name, *row, verdict)
        paper = (f"{getattr(PAPER_STATISTICS[name], kind):.4f}" for kind in _KINDS)
        table.add_row("  paper, real", *paper, style="dim")
    return table
