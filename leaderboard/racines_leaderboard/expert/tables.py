"""A study's report as tables for a terminal."""

from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

COLUMNS = {
    "view_agreement": ("view (%)", 100.0, 1),
    "view_kappa": ("view κ", 1.0, 3),
    "grade_agreement": ("grade ± 1 (%)", 100.0, 1),
    "grade_exact": ("grade = (%)", 100.0, 1),
    "grade_kappa": ("grade κ, quadratic", 1.0, 3),
    "grade_difference": ("grade difference", 1.0, 2),
}


def show(report: dict[str, Any], console: Console) -> None:
    """Print a report."""
    rows = {
        (name, reference): told["metrics"]
        for name, system in report["systems"].items()
        for reference, told in system["references"].items()
    }
    raters = ", ".join(each["rater"] for each in report["raters"])
    _print(console, f"{report['kind']} ({raters})", ("system", "against"), rows)
    repeats = {
        (each["rater"], "itself"): each["repeats"]["metrics"]
        for each in report["raters"]
        if each["repeats"] is not None
    }
    _print(console, "images shown twice", ("rater", "against"), repeats)
    if report["between"] is not None:
        pairs = {tuple(p["raters"]): p["metrics"] for p in report["between"]["pairs"]}
        _print(console, "raters with each other", ("rater", "against"), pairs)
        fleiss = report["between"]["fleiss_kappa"]
        console.print(f"Fleiss' κ of the views: {_cell(fleiss, 1.0, 3)}, n = {fleiss['n']}")
    console.print(f"Lines below a figure: 95 % interval. {report['remark']}", style="dim")


def _print(
    console: Console,
    title: str,
    head: tuple[str, str],
    rows: dict[tuple[str, ...], dict[str, Any]],
) -> None:
    if not rows:
        return
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
    for name in head:
        table.add_column(name)
    for name, _, _ in COLUMNS.values():
        table.add_column(name, justify="right")
    table.add_column("n", justify="right")
    for names, metrics in rows.items():
        cells = [_cell(metrics[k], scale, digits) for k, (_, scale, digits) in COLUMNS.items()]
        table.add_row(*names, *cells, str(metrics["view_agreement"]["n"]))
    console.print(table)


def _cell(metric: dict[str, Any], scale: float, digits: int) -> str:
    if metric["value"] is None:
        return "–"
    text = f"{scale * metric['value']:.{digits}f}"
    if metric["low"] is None:
        return text
    return f"{text}\n{scale * metric['low']:.{digits}f}–{scale * metric['high']:.{digits}f}"
