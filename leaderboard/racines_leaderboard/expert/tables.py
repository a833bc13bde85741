"""A study's report as tables for a terminal."""

from typing import Any

from rich.console import Console

from racines_data.tables import console_table

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
        (name, reference): agreement["metrics"]
        for name, system in report["systems"].items()
        for reference, agreement in system["references"].items()
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
    lines = [
        (
            *names,
            *(_cell(metrics[key], scale, digits) for key, (_, scale, digits) in COLUMNS.items()),
            str(metrics["view_agreement"]["n"]),
        )
        for names, metrics in rows.items()
    ]
    columns = (*head, *(name for name, _, _ in COLUMNS.values()), "n")
    console.print(console_table(columns, lines, title, right=2))


def _cell(metric: dict[str, Any], scale: float, digits: int) -> str:
    if metric["value"] is None:
        return "–"
    text = f"{scale * metric['value']:.{digits}f}"
    if metric["low"] is None:
        return text
    return f"{text}\n{scale * metric['low']:.{digits}f}–{scale * metric['high']:.{digits}f}"
