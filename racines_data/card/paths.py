"""Paths of a card: trajectories over the block in 3-D, and the grade along one sweep a view."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from racines_data.card.frames import Frames
from racines_data.plotting import MUTED, evenly, view_colours

PATHS = 60
"""Trajectories drawn, at most."""
POINTS = 120
"""Points of a trajectory drawn, at most."""


def trajectories_figure(frames: Frames, manifest: dict[str, Any]) -> Figure:
    """Draw paths of the probe's tip, and the grade along the best sweep of each view."""
    sweeps = _best_sweeps(frames)
    figure = Figure(figsize=(10.0, 5.0) if sweeps else (6.4, 5.0))
    left = (-0.01, 0.10, 0.62, 0.92) if sweeps else (0.0, 0.10, 0.94, 0.92)
    _paths(figure, left, frames, block_top(manifest))
    if sweeps:
        _grades(figure, frames, sweeps)
    return figure


def _paths(
    figure: Figure,
    place: tuple[float, float, float, float],
    frames: Frames,
    top: tuple[np.ndarray, np.ndarray] | None,
) -> None:
    axis = figure.add_axes(place, projection="3d")
    assert isinstance(axis, Axes3D)
    axis.set_proj_type("persp", focal_length=0.6)
    axis.view_init(elev=28, azim=-58)
    if top is not None:
        corners = rectangle(*top)
        face = Poly3DCollection([corners], facecolor="#d9c7a8", edgecolor="#8c7a5b", alpha=0.35)
        axis.add_collection3d(face)
    colours, used = view_colours(frames.labels), {}
    for index in evenly(len(frames.trajectories), PATHS):
        rows = frames.rows_of(int(index))
        tip = 1e3 * frames.parameters[rows, 6:9].astype(float)
        tip = tip[evenly(len(tip), POINTS)]
        name = frames.target_views[index]
        used[name] = colours.get(name, MUTED)
        axis.plot(*tip.T, color=used[name], lw=1.0, alpha=0.85)
    names = [name for name in (*frames.labels, *used) if name in used]
    handles = [
        Line2D([], [], color=used[name], lw=2.2, label=name) for name in dict.fromkeys(names)
    ]
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), handlelength=1.4,
        bbox_to_anchor=(place[0] + place[2] / 2, 0.0), title="target view",
    )  # fmt: skip
    for letter in "xyz":
        getattr(axis, f"set_{letter}label")(f"{letter}, mm", labelpad=-3 if letter == "z" else 2)
    axis.tick_params(pad=0, labelsize=7.5)
    axis.zaxis.set_major_locator(MaxNLocator(5))
    axis.set_box_aspect((1.2, 1.0, 0.62), zoom=1.1)  # pyright: ignore[reportArgumentType]


def rectangle(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return (4, 3) corners of a box's top face, mm."""
    x, y, z = (low[0], high[0]), (low[1], high[1]), high[2]
    return 1e3 * np.array([[x[i], y[j], z] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])


def block_top(manifest: dict[str, Any]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the block's corners, m, if the recipe is one of the phantom."""
    settings = manifest.get("recipe", {}).get("settings", {})
    block = settings.get("acquisition", {}).get("phantom", {}).get("block")
    if not block:
        return None
    return np.array(block["minimum"]), np.array(block["maximum"])


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
    grid = figure.add_gridspec(len(sweeps), 1, left=0.685, right=0.985, top=0.93, bottom=0.10)
    first = None
    for line, (name, index) in enumerate(sweeps.items()):
        axis = figure.add_subplot(grid[line], sharex=first)
        first = first or axis
        rows = frames.rows_of(index)
        time = frames.timestamps[rows] - frames.timestamps[rows.start]
        grades, aimed = frames.grades[rows], frames.views[rows] == frames.labels.index(name)
        axis.fill_between(
            time, 0, 10, where=aimed, color=colours[name], alpha=0.13, lw=0, step="mid"
        )
        axis.plot(time, grades, color=colours[name], lw=1.6)
        axis.set_ylim(0, 10)
        axis.set_yticks((0, 5, 10))
        axis.set_ylabel(name, color=colours[name], weight="bold")
        axis.margins(x=0.01)
        axis.tick_params(labelbottom=line == len(sweeps) - 1)
        if line == 0:
            axis.set_title("grade along one sweep of each view")
        if line == len(sweeps) - 1:
            axis.set_xlabel("time, s")
