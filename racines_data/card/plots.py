"""Charts of a card: the twelve parameters, and the shares of classes and grades."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from racines_data.card.frames import Frames
from racines_data.card.statistics import CACTUS_COUNTS, GRADE_EDGES, unit_of
from racines_data.plotting import MUTED, OURS, PAPER, SPLIT_COLOURS, view_colours
from racines_data.schema import PARAMETERS
from racines_data.views import PAPER_STATISTICS

BINS = 60


def parameters_figure(frames: Frames, statistics: dict[str, Any], paper: bool) -> Figure:
    """Draw a histogram of each measured parameter, with the paper's statistics where they apply."""
    names = [name for name in PARAMETERS if name in statistics["parameters"]]
    rows = -(-len(names) // 3)
    figure = Figure(figsize=(10.0, 2.05 * rows + 0.55))
    axes = figure.subplots(rows, 3, squeeze=False).flat
    for axis, name in zip(axes, names, strict=False):
        values = frames.parameters[:, PARAMETERS.index(name)]
        _parameter(axis, name, values[np.isfinite(values)], statistics["parameters"][name], paper)
    handles = [
        Patch(color=OURS, alpha=0.75, label="this dataset, share of frames"),
        Line2D([], [], color=OURS, lw=1.6, label="its mean"),
    ]
    if paper:
        handles += [
            Line2D([], [], color=PAPER, lw=1.6, label="paper's mean"),
            Patch(color=PAPER, alpha=0.13, label="paper's mean ± std"),
            Line2D([], [], color=PAPER, lw=1.0, ls=(0, (3, 2)), label="paper's min and max"),
        ]
    height = figure.get_figheight()
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), columnspacing=1.6)
    figure.subplots_adjust(0.05, 0.42 / height, 0.99, 1.0 - 0.62 / height, wspace=0.21, hspace=0.45)
    for axis in figure.axes[len(names) :]:
        axis.set_visible(False)
    return figure


def _parameter(
    axis: Axes, name: str, values: np.ndarray, ours: dict[str, float], paper: bool
) -> None:
    low, high = ours["minimum"], ours["maximum"]
    if paper:
        known = PAPER_STATISTICS[name]
        low, high = min(low, known.minimum), max(high, known.maximum)
        axis.axvspan(known.mean - known.std, known.mean + known.std, color=PAPER, alpha=0.13, lw=0)
        axis.axvline(known.mean, color=PAPER, lw=1.6)
        for edge in (known.minimum, known.maximum):
            axis.axvline(edge, color=PAPER, lw=1.0, ls=(0, (3, 2)))
    if low == high:
        low, high = low - 0.5, high + 0.5
    counts, edges = np.histogram(values, BINS, (low, high))
    axis.stairs(100.0 * counts / len(values), edges, fill=True, color=OURS, alpha=0.75)
    axis.axvline(ours["mean"], color=OURS, lw=1.6)
    margin = 0.04 * (high - low)
    axis.set_xlim(low - margin, high + margin)
    axis.set_title(name)
    axis.set_xlabel(unit_of(name), labelpad=1)
    axis.set_ylabel("%", labelpad=1)
    axis.locator_params(axis="x", nbins=5)
    axis.locator_params(axis="y", nbins=4)


def shares_figure(frames: Frames, statistics: dict[str, Any], cactus: bool) -> Figure:
    """Draw the shares of the classes and of the grades, by split and by view."""
    graded = bool(np.isfinite(frames.grades).any())
    figure = Figure(figsize=(10.0, 3.5) if graded else (6.0, 3.5))
    if graded:
        classes, grades, by_split = figure.subplots(1, 3, width_ratios=(1.25, 1, 1))
        _grades_by_view(grades, frames)
        _grades_by_split(by_split, statistics["grades"])
    else:
        classes = figure.subplots()
    _classes(classes, statistics["views"], frames.labels, cactus)
    left = 0.6 / figure.get_figwidth()
    figure.subplots_adjust(left, 0.15, 0.99, 0.9, wspace=0.24)
    return figure


def _classes(
    axis: Axes, views: dict[str, dict[str, int]], labels: tuple[str, ...], cactus: bool
) -> None:
    series = {}
    for split, counts in views.items():
        total = sum(counts[name] for name in labels)
        if total:
            share = [100.0 * counts[name] / total for name in labels]
            series[split] = share, {"color": SPLIT_COLOURS[split]}
    if cactus:
        whole = sum(CACTUS_COUNTS.values())
        share = [100.0 * CACTUS_COUNTS[name] / whole for name in labels]
        series["CACTUS"] = share, {"color": "white", "edgecolor": PAPER, "hatch": "////"}
    width = 0.84 / len(series)
    for index, (name, (share, look)) in enumerate(series.items()):
        place = np.arange(len(labels)) + (index - (len(series) - 1) / 2) * width
        axis.bar(place, share, width * 0.92, label=name, linewidth=0.8, **look)
    axis.set_xticks(np.arange(len(labels)), labels)
    axis.tick_params(axis="x", length=0)
    axis.grid(False, axis="x")
    axis.set_ylabel("share of the split's frames, %")
    axis.set_title("classes")
    axis.set_ylim(0, axis.get_ylim()[1] * 1.25)
    axis.legend(ncols=2, loc="upper left", handlelength=1.2, columnspacing=1.2)


def _grades_by_view(axis: Axes, frames: Frames) -> None:
    colours, base = view_colours(frames.labels), np.zeros(11)
    whole = int(np.isfinite(frames.grades).sum())
    for label, name in enumerate(frames.labels):
        grades = frames.grades[frames.views == label]
        counts = np.histogram(grades[np.isfinite(grades)], GRADE_EDGES)[0]
        if counts.any():
            share = 100.0 * counts / whole
            axis.bar(np.arange(11), share, 0.86, bottom=base, color=colours[name], label=name)
            base += share
    axis.set_title("grades by class")
    axis.set_ylabel("share of all graded frames, %")
    _grade_axis(axis)
    axis.legend(loc="upper right", handlelength=1.0, ncols=2, columnspacing=1.0)
    axis.set_ylim(0, max(base.max() * 1.08, 1.0))


def _grades_by_split(axis: Axes, grades: dict[str, dict[str, Any]]) -> None:
    edges = np.arange(12) - 0.5
    for split, found in grades.items():
        counts = np.array(found["counts"])
        if counts.any():
            share, colour = 100.0 * counts / counts.sum(), SPLIT_COLOURS[split]
            axis.stairs(share, edges, color=colour, lw=1.9, label=split, baseline=None)
    axis.set_title("grades of the views, by split")
    axis.set_ylabel("share of the split's frames of a view, %")
    _grade_axis(axis)
    axis.set_ylim(0, axis.get_ylim()[1] * 1.22)
    axis.legend(loc="upper left")


def _grade_axis(axis: Axes) -> None:
    axis.set_xticks(np.arange(0, 11, 2))
    axis.set_xlim(-0.7, 10.7)
    axis.grid(False, axis="x")
    axis.set_xlabel("grade, rounded (0: no view)", color=MUTED)
