"""A picture of a study: confusion matrices of views and grades, and agreement by system."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.files import write_atomic
from racines_data.plotting import INK, MUTED, OURS, PAPER, card_style
from racines_leaderboard.records.experts import OVERALL

TITLES = {"oracle": "the oracle", "labels": "the dataset's labels", "grader": "the grader"}
RATERS = {"expert": "expert", "trial": "trial", "simulated": "simulated rater"}


def write_picture(path: Path, report: dict[str, Any]) -> None:
    """Draw a report as PNG: one row a reference."""
    with card_style():
        drawn = io.BytesIO()
        draw(report).savefig(drawn, format="png", metadata={"Software": None})
        write_atomic(path, drawn.getvalue())


def draw(report: dict[str, Any]) -> Figure:
    """Return the figure; see `write_picture`."""
    references = list(report["systems"][OVERALL]["references"])
    figure = Figure(figsize=(12.5, 0.6 + 3.9 * len(references)), layout="constrained")
    rows = figure.subplots(len(references), 3, squeeze=False, width_ratios=(1.0, 1.25, 1.0))
    rater = RATERS.get(report["kind"], f"{report['kind']} as rater")
    for (left, middle, right), name in zip(rows, references, strict=True):
        agreement = report["systems"][OVERALL]["references"][name]
        labels, reference = report["kit"]["labels"], TITLES[name]
        _matrix(left, agreement["confusion"]["views"], labels, f"Views, {OVERALL}", True)
        grades = agreement["confusion"]["grades"]
        _matrix(middle, grades, [*map(str, range(len(grades)))], f"Grades, {OVERALL}", False)
        for axes in (left, middle):
            axes.set_xlabel(rater)
            axes.set_ylabel(reference)
        _systems(right, report, name)
        right.set_title(f"Agreement with {reference}")
    figure.suptitle(f"{len(report['raters'])} × {rater}. {report['remark']}", size=9.5)
    return figure


def _matrix(axes: Axes, counts: Any, names: list[str], title: str, shares: bool) -> None:
    counts = np.array(counts)
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    axes.imshow(share**0.5, cmap="Blues", vmin=0.0, vmax=1.1, aspect="auto")
    axes.grid(False)
    for row, column in np.ndindex(*counts.shape):
        if counts[row, column]:
            part = f"\n{100 * share[row, column]:.0f} %" if shares else ""
            style = {"color": "white" if share[row, column] > 0.4 else INK, "fontsize": 7.0}
            text = f"{counts[row, column]:,}{part}"
            axes.text(column, row, text, ha="center", va="center", **style)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_title(title)


def _systems(axes: Axes, report: dict[str, Any], reference: str) -> None:
    names = list(report["systems"])
    bars = (("view_agreement", "view", OURS, -0.13), ("grade_agreement", "grade ± 1", PAPER, 0.13))
    for key, label, colour, shift in bars:
        for row, name in enumerate(names):
            metric = report["systems"][name]["references"][reference]["metrics"][key]
            if metric["value"] is None:
                continue
            ends = [100 * metric["low"], 100 * metric["high"]]
            y = row + shift
            axes.plot(ends, [y, y], color=colour, alpha=0.45, linewidth=4, solid_capstyle="butt")
            shown = label if row == 0 else None
            axes.plot([100 * metric["value"]], [y], "o", color=colour, markersize=5, label=shown)
    axes.set_yticks(range(len(names)), [_counted(report, name, reference) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0, 102)
    axes.set_xlabel("% of images, Wilson 95 %")
    axes.tick_params(axis="y", labelcolor=MUTED)
    axes.legend(loc="best")


def _counted(report: dict[str, Any], system: str, reference: str) -> str:
    metrics = report["systems"][system]["references"][reference]["metrics"]
    return f"{system}\nn = {metrics['view_agreement']['n']}"
