"""Pictures of a grader's report: confusion, reliability, grades, error by view."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from racines_data.files import write_atomic
from racines_data.plotting import INK, MUTED, OURS, PAPER, card_style, encode, view_colours
from racines_models.judges.grader.calibration import reliability
from racines_models.judges.grader.report import Examination

GRADES = (0.0, 10.0)


def write_plots(folder: Path, examined: Examination) -> list[str]:
    """Draw the report into `folder`: `confusion.png`, `reliability.png`, `grades.png`, `views.png`.

    What a split without views or grades cannot show is left out.

    Returns:
        The names of the files written.
    """
    figures: dict[str, Figure] = {}
    with card_style():
        if bool((examined.views >= 0).any()):
            figures["confusion"] = confusion_figure(examined)
            figures["reliability"] = reliability_figure(examined)
        if examined.content["grades"]:
            figures["grades"] = grades_figure(examined)
            figures["views"] = views_figure(examined)
        for name, figure in figures.items():
            write_atomic(folder / f"{name}.png", encode(figure))
    return [f"{name}.png" for name in figures]


def confusion_figure(examined: Examination) -> Figure:
    """Draw the counts and the shares of each true label's frames, one row a true label."""
    counts = np.array(examined.content["confusion"]["counts"])
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    names = examined.names
    figure = Figure(figsize=(1.6 + 0.75 * len(names), 1.4 + 0.62 * len(names)), layout="tight")
    axes = figure.subplots()
    axes.imshow(share**0.5, cmap="Blues", vmin=0.0, vmax=1.1, aspect="auto")
    axes.grid(False)
    for row, column in np.ndindex(*counts.shape):
        if counts[row, column]:
            text = f"{100 * share[row, column]:.1f} %\n{counts[row, column]:,}"
            white = share[row, column] > 0.4
            style = {"color": "white" if white else INK, "fontsize": 7.5}
            axes.text(column, row, text, ha="center", va="center", **style)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel("label given")
    axes.set_ylabel("true label")
    accuracy = examined.content["metrics"]["view_accuracy"]["value"]
    axes.set_title(f"Views, {examined.content['split']} split: {100 * accuracy:.2f} % right")
    return figure


def reliability_figure(examined: Examination) -> Figure:
    """Draw accuracy against confidence, before and after the temperature, over a histogram."""
    figure = Figure(figsize=(4.6, 4.8), layout="tight")
    upper, lower = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    upper.plot([0, 1], [0, 1], color=MUTED, linewidth=0.8, linestyle=":", label="perfect")
    after = f"after, T = {examined.temperature:.2f}"
    looks = (
        ("before", 1.0, "before", PAPER, "s"),
        ("after", examined.temperature, after, OURS, "o"),
    )
    for key, temperature, name, colour, marker in looks:
        table = reliability((examined.reading.logits / temperature).softmax(-1), examined.views)
        filled = table.frames > 0
        x, y = table.confidence[filled], table.accuracy[filled]
        error = examined.content["calibration"][key]["value"]
        label = f"{name}: ECE {100 * error:.2f} %"
        upper.plot(x, y, color=colour, marker=marker, markersize=4, linewidth=1.2, label=label)
        lower.step(x, table.frames[filled], color=colour, where="mid", linewidth=1.2)
    upper.set_ylabel("accuracy")
    upper.set_ylim(0.0, 1.02)
    upper.set_title(f"Calibration, {examined.content['split']} split")
    upper.legend(loc="upper left")
    lower.set_yscale("log")
    lower.set_ylabel("frames")
    lower.set_xlabel("confidence, mean of a bin")
    return figure


def grades_figure(examined: Examination) -> Figure:
    """Draw the grade given against the true one, a panel a view; darker is more frames."""
    names = [name for name in examined.names if name in examined.content["grades"]]
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(2.5 * columns + 0.4, 2.4 * rows + 0.5), layout="tight")
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for axes, name in zip(panels, names, strict=False):
        chosen = (
            (examined.views == examined.names.index(name)) & examined.grades.isfinite()
        ).numpy()
        truth = examined.grades.numpy()[chosen]
        given = examined.reading.grades.numpy()[chosen]
        axes.hist2d(
            truth, given, 40, (GRADES, GRADES), cmap="Blues", norm=LogNorm(vmin=0.3), cmin=1
        )
        axes.plot(GRADES, GRADES, color=MUTED, linewidth=0.8, linestyle=":")
        figures = examined.content["grades"][name]
        mae, bias = figures["mae"]["value"], figures["bias"]["value"]
        axes.set_title(f"{name}: MAE {mae:.2f}, bias {bias:+.2f}")
        axes.set_aspect("equal")
    for axes in panels[max(len(names) - columns, 0) : len(names)]:
        axes.tick_params(labelbottom=True)  # the lowest of each column
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel("true grade", fontsize=8.5, color=INK)
    figure.supylabel("grade given", fontsize=8.5, color=INK)
    return figure


def views_figure(examined: Examination) -> Figure:
    """Draw, by view, accuracy, mean absolute error and bias of the grade, with 95 % intervals."""
    content = examined.content
    figure = Figure(figsize=(8.4, 0.3 * len(examined.names) + 1.3), layout="tight")
    panels = figure.subplots(1, 3)
    mae = {name: each["mae"] for name, each in content["grades"].items()}
    bias = {name: each["bias"] for name, each in content["grades"].items()}
    colours = view_colours(examined.names)
    _intervals(panels[0], content["views"], colours, "view accuracy")
    _intervals(panels[1], mae, colours, "grade, mean absolute error")
    _intervals(panels[2], bias, colours, "grade, bias")
    panels[1].set_xlim(left=0.0)
    panels[2].axvline(0.0, color=MUTED, linewidth=0.8)
    return figure


def _intervals(axes: Axes, figures: dict[str, Any], colours: dict[str, str], title: str) -> None:
    for row, (name, figure) in enumerate(figures.items()):
        value, low, high = (figure[key] for key in ("value", "low", "high"))
        if low is not None:
            axes.plot([low, high], [row, row], color=colours[name], linewidth=2.2)
        axes.plot(value, row, "o", color=colours[name], markersize=5)
        axes.annotate(
            f"{value:.3f}",
            (value, row),
            (0, 5),
            textcoords="offset points",
            ha="center",
            fontsize=7,
        )
    axes.set_yticks(range(len(figures)), list(figures))
    axes.set_ylim(len(figures) - 0.5, -0.7)
    axes.set_title(title)
