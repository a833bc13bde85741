"""Charts of a card: the twelve parameters, shares of classes and grades, and the probe's paths."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from racines_data.card.columns import PIXELS_UNIT, unit_of
from racines_data.card.frames import CACTUS_COUNTS, GRADE_EDGES, Frames
from racines_data.plotting import (
    MUTED,
    OURS,
    PAPER,
    SAND,
    SAND_EDGE,
    SMALL,
    SPLIT_COLOURS,
    evenly,
    view_colours,
)
from racines_data.schema import PARAMETERS
from racines_data.views import PAPER_STATISTICS

BINS = 60
PATHS = 60
"""Trajectories drawn, at most."""
POINTS = 120
"""Points of a trajectory drawn, at most."""
_Rectangle = tuple[float, float, float, float]


def parameters_figure(frames: Frames, statistics: dict[str, Any], paper: bool) -> Figure:
    """Draw a histogram of each measured parameter, with the paper's statistics where they apply."""
    names = [name for name in PARAMETERS if name in statistics["parameters"]]
    rows = -(-len(names) // 3)
    figure = Figure(figsize=(10.0, 2.05 * rows + 0.55))
    axes = figure.subplots(rows, 3, squeeze=False).flat
    for axis, name in zip(axes, names, strict=False):
        values = frames.parameters[:, PARAMETERS.index(name)]
        _parameter(axis, name, values[np.isfinite(values)], statistics["parameters"][name], paper)
        axis.set_xlabel(unit_of(name, frames.scaled), labelpad=1)
    known = int(np.isfinite(frames.parameters).any(1).sum())
    handles = [
        Patch(color=OURS, alpha=0.75, label=f"this dataset, share of {known:,} frames"),
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
    axis.set(xlim=(low - margin, high + margin), title=name)
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
    looks: dict[str, dict[str, Any]] = {name: {"color": SPLIT_COLOURS[name]} for name in views}
    if cactus:
        views = {**views, "CACTUS": CACTUS_COUNTS}
        looks["CACTUS"] = {"color": "white", "edgecolor": PAPER, "hatch": "////"}
    totals = {name: sum(counts[label] for label in labels) for name, counts in views.items()}
    drawn = [name for name in views if totals[name]]
    width = 0.84 / len(drawn)
    for index, name in enumerate(drawn):
        share = [100.0 * views[name][label] / totals[name] for label in labels]
        place = np.arange(len(labels)) + (index - (len(drawn) - 1) / 2) * width
        told = f"{name}, n = {totals[name]:,}"
        axis.bar(place, share, width * 0.92, label=told, linewidth=0.8, **looks[name])
    axis.set_xticks(np.arange(len(labels)), labels)
    axis.tick_params(axis="x", length=0)
    axis.grid(False, axis="x")
    top = 1.25 * axis.get_ylim()[1]
    axis.set(ylabel="share of the split's frames, %", title="classes", ylim=(0, top))
    axis.legend(ncols=2, loc="upper left", handlelength=1.2, columnspacing=1.2, fontsize=SMALL)


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
    axis.legend(loc="upper right", handlelength=1.0, ncols=2, columnspacing=1.0)
    top = max(base.max() * 1.08, 1.0)
    _label(axis, f"grades by class, n = {whole:,}", "share of all graded frames, %", top)


def _grades_by_split(axis: Axes, grades: dict[str, dict[str, Any]]) -> None:
    edges = np.arange(12) - 0.5
    for split, found in grades.items():
        counts = np.array(found["counts"])
        if counts.any():
            share, colour = 100.0 * counts / counts.sum(), SPLIT_COLOURS[split]
            told = f"{split}, n = {counts.sum():,}"
            axis.stairs(share, edges, color=colour, lw=1.9, label=told, baseline=None)
    axis.legend(loc="upper left")
    top = axis.get_ylim()[1] * 1.22
    _label(axis, "grades of the views, by split", "share of the split's frames of a view, %", top)


def _label(axis: Axes, title: str, share: str, top: float) -> None:
    axis.set(
        title=title, ylabel=share, xticks=np.arange(0, 11, 2), xlim=(-0.7, 10.7), ylim=(0, top)
    )
    axis.grid(False, axis="x")
    axis.set_xlabel("grade, rounded (0: no view)", color=MUTED)


def trajectories_figure(frames: Frames, manifest: dict[str, Any]) -> Figure:
    """Draw paths of the probe's tip, and the grade along the best sweep of each view."""
    sweeps = _best_sweeps(frames)
    figure = Figure(figsize=(10.0, 5.0) if sweeps else (6.4, 5.0))
    left = (-0.01, 0.10, 0.62, 0.92) if sweeps else (0.0, 0.10, 0.94, 0.92)
    _paths(figure, left, frames, manifest)
    if sweeps:
        _grades(figure, frames, sweeps)
    return figure


def _paths(figure: Figure, place: _Rectangle, frames: Frames, manifest: dict[str, Any]) -> None:
    axis = block_axes(figure, place, manifest, 0.35)
    colours, used = view_colours(frames.labels), {}
    scale, unit = (1e3, "mm") if frames.scaled else (1.0, PIXELS_UNIT)
    for index in evenly(len(frames.target_views), PATHS):
        rows = frames.rows_of(int(index))
        tip = scale * frames.parameters[rows, 6:9].astype(float)
        tip = tip[evenly(len(tip), POINTS)]
        name = frames.target_views[index]
        used[name] = colours.get(name, MUTED)
        axis.plot(*tip.T, color=used[name], lw=1.0, alpha=0.85)
    names = dict.fromkeys(name for name in (*frames.labels, *used) if name in used)
    every = len(frames.target_views)
    told = f"{min(every, PATHS)} of {every:,} trajectories"
    handles = [Line2D([], [], color=used[name], lw=2.2, label=name) for name in names]
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), handlelength=1.4,
        bbox_to_anchor=(place[0] + place[2] / 2, 0.0), title=f"target view; {told}",
    )  # fmt: skip
    for letter in "xyz":
        getattr(axis, f"set_{letter}label")(
            f"{letter}, {unit}", labelpad=-3 if letter == "z" else 2
        )
    axis.tick_params(pad=0, labelsize=7.5)
    axis.zaxis.set_major_locator(MaxNLocator(5))
    axis.set_box_aspect((1.2, 1.0, 0.62), zoom=1.1)  # pyright: ignore[reportArgumentType]


def block_axes(figure: Figure, place: _Rectangle, manifest: dict[str, Any], alpha: float) -> Axes3D:
    """Return axes in mm, with the block's top face where the recipe is one of the phantom."""
    axis = figure.add_axes(place, projection="3d")
    assert isinstance(axis, Axes3D)
    axis.set_proj_type("persp", focal_length=0.6)
    axis.view_init(elev=28, azim=-58)
    settings = manifest.get("recipe", {}).get("settings", {})
    block = settings.get("acquisition", {}).get("phantom", {}).get("block")
    if block:
        (left, near, _), (right, far, top) = block["minimum"], block["maximum"]
        corners = ((left, near), (right, near), (right, far), (left, far))
        face = 1e3 * np.array([[x, y, top] for x, y in corners])
        look: dict[str, Any] = {"facecolor": SAND, "edgecolor": SAND_EDGE, "alpha": alpha}
        axis.add_collection3d(Poly3DCollection([face], **look))
    return axis


def _best_sweeps(frames: Frames) -> dict[str, int]:
    """Return, for each target view, the sweep that ranges over most grades."""
    best: dict[str, tuple[float, int]] = {}
    for index, name in enumerate(frames.target_views):
        rows = frames.rows_of(index)
        grades = frames.grades[rows][np.isfinite(frames.grades[rows])]
        if name in frames.labels[:-1] and len(grades) > 1:
            span = float(grades.max() - grades.min())
            best[name] = max(best.get(name, (-1.0, 0)), (span, -index))
    return {name: -best[name][1] for name in frames.labels if name in best}


def _grades(figure: Figure, frames: Frames, sweeps: dict[str, int]) -> None:
    colours = view_colours(frames.labels)
    place = {"left": 0.685, "right": 0.985, "top": 0.93, "bottom": 0.10}
    axes = figure.subplots(len(sweeps), sharex=True, squeeze=False, gridspec_kw=place)[:, 0]
    for axis, (name, index) in zip(axes, sweeps.items(), strict=True):
        rows = frames.rows_of(index)
        time = frames.timestamps[rows] - frames.timestamps[rows.start]
        grades, aimed = frames.grades[rows], frames.views[rows] == frames.labels.index(name)
        look = {"color": colours[name], "alpha": 0.13, "lw": 0, "step": "mid"}
        axis.fill_between(time, 0, 10, where=aimed, **look)
        axis.plot(time, grades, color=colours[name], lw=1.6)
        axis.set(ylim=(0, 10), yticks=(0, 5, 10))
        axis.set_ylabel(name, color=colours[name], weight="bold")
        axis.margins(x=0.01)
    axes[0].set_title("grade along one sweep of each view")
    axes[-1].set_xlabel("time, s")
