"""A study's report as tables for a terminal, and as a picture: confusion and agreement."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from racines_data.files import write_atomic
from racines_data.plotting import INK, MUTED, OURS, PAPER, card_style
from racines_data.tables import console_table
from racines_leaderboard.records.experts import OVERALL

COLUMNS = {
    "view_agreement": ("view (%)", 100.0, 1),
    "view_kappa": ("view κ", 1.0, 3),
    "grade_agreement": ("grade ± 1 (%)", 100.0, 1),
    "grade_exact": ("grade = (%)", 100.0, 1),
    "grade_kappa": ("grade κ, quadratic", 1.0, 3),
    "grade_difference": ("grade difference", 1.0, 2),
}
TITLES = {"oracle": "the oracle", "labels": "the dataset's labels", "grader": "the grader"}
RATERS = {"expert": "expert", "trial": "trial", "simulated": "simulated rater"}
BARS = (("view_agreement", "view", OURS, -0.13), ("grade_agreement", "grade ± 1", PAPER, 0.13))


def show(report: dict[str, Any], console: Console) -> None:
    """Print a report."""
    raters, between = report["raters"], report["between"]
    everyone = f"{report['kind']} ({', '.join(each['rater'] for each in raters)})"
    systems = [
        (name, reference, agreement["metrics"])
        for name, system in report["systems"].items()
        for reference, agreement in system["references"].items()
    ]
    again = [(r["rater"], "itself", r["repeats"]["metrics"]) for r in raters if r["repeats"]]
    pairs = [(*pair["raters"], pair["metrics"]) for pair in between["pairs"]] if between else []
    for title, first, rows in (
        (everyone, "system", systems),
        ("images shown twice", "rater", again),
        ("raters with each other", "rater", pairs),
    ):
        lines = []
        for *names, metrics in rows:
            cells = [_cell(metrics[key], scale, n) for key, (_, scale, n) in COLUMNS.items()]
            lines.append((*names, *cells, str(metrics["view_agreement"]["n"])))
        if lines:
            head = (first, "against", *(name for name, *_ in COLUMNS.values()), "n")
            console.print(console_table(head, lines, title, right=2))
    if between:
        fleiss = between["fleiss_kappa"]
        console.print(f"Fleiss' κ of the views: {_cell(fleiss, 1.0, 3)}, n = {fleiss['n']}")
    console.print(f"Lines below a figure: 95 % interval. {report['remark']}", style="dim")


def _cell(metric: dict[str, Any], scale: float, digits: int) -> str:
    value, low, high = (
        None if metric[key] is None else f"{scale * metric[key]:.{digits}f}"
        for key in ("value", "low", "high")
    )
    if value is None:
        return "–"
    return value if low is None else f"{value}\n{low}–{high}"


def write_picture(path: Path, report: dict[str, Any]) -> None:
    """Draw a report as PNG: one row a reference."""
    with card_style():
        drawn = io.BytesIO()
        draw(report).savefig(drawn, format="png", metadata={"Software": None})
        write_atomic(path, drawn.getvalue())


def draw(report: dict[str, Any]) -> Figure:
    """Return the figure; see `write_picture`."""
    references = report["systems"][OVERALL]["references"]
    figure = Figure(figsize=(12.5, 0.6 + 3.9 * len(references)), layout="constrained")
    rows = figure.subplots(len(references), 3, squeeze=False, width_ratios=(1.0, 1.25, 1.0))
    rater = RATERS.get(report["kind"], f"{report['kind']} as rater")
    for (left, middle, right), (name, agreement) in zip(rows, references.items(), strict=True):
        labels, reference = report["kit"]["labels"], TITLES[name]
        _matrix(left, agreement["confusion"]["views"], labels, f"Views, {OVERALL}", True)
        grades = agreement["confusion"]["grades"]
        _matrix(middle, grades, [*map(str, range(len(grades)))], f"Grades, {OVERALL}", False)
        for axes in (left, middle):
            axes.set_xlabel(rater)
            axes.set_ylabel(reference)
        of_systems = report["systems"].items()
        _systems(right, {key: each["references"][name]["metrics"] for key, each in of_systems})
        right.set_title(f"Agreement with {reference}")
    figure.suptitle(f"{len(report['raters'])} × {rater}. {report['remark']}", size=9.5)
    return figure


def _matrix(axes: Axes, counts: Any, names: list[str], title: str, shares: bool) -> None:
    counts = np.array(counts)
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    axes.imshow(share**0.5, cmap="Blues", vmin=0.0, vmax=1.1, aspect="auto")
    axes.grid(False)
    for row, column in np.argwhere(counts):
        part = f"\n{100 * share[row, column]:.0f} %" if shares else ""
        style = {"color": "white" if share[row, column] > 0.4 else INK, "fontsize": 7.0}
        text = f"{counts[row, column]:,}{part}"
        axes.text(column, row, text, ha="center", va="center", **style)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_title(title)


def _systems(axes: Axes, systems: dict[str, dict[str, Any]]) -> None:
    """Draw the agreement of systems, by name, with one reference."""
    for key, label, colour, shift in BARS:
        for row, metrics in enumerate(systems.values()):
            metric, y = metrics[key], row + shift
            if metric["value"] is None:
                continue
            ends = [100 * metric["low"], 100 * metric["high"]]
            axes.plot(ends, [y, y], color=colour, alpha=0.45, linewidth=4, solid_capstyle="butt")
            shown = label if row == 0 else None
            axes.plot([100 * metric["value"]], [y], "o", color=colour, markersize=5, label=shown)
    counted = [f"{name}\nn = {each['view_agreement']['n']}" for name, each in systems.items()]
    axes.set_yticks(range(len(systems)), counted)
    axes.set_ylim(len(systems) - 0.4, -0.6)
    axes.set_xlim(0, 102)
    axes.set_xlabel("% of images, Wilson 95 %")
    axes.tick_params(axis="y", labelcolor=MUTED)
    axes.legend(loc="best")
