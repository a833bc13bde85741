"""Figures of one trajectory: the grade over time, and the probe's path over the block in 3-D.

Each is drawn once a trajectory; where in it a frame lies is told in shares of its width and height,
so that a page can move a mark over the picture instead of drawing it again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from racines_data.card.paths import block_top, rectangle
from racines_data.geometry import parameters_to_pose
from racines_data.plotting import MUTED, evenly, view_colours
from racines_leaderboard.studio.browsing import Sweep
from racines_leaderboard.studio.pictures import drawn

BEAMS, BEAM = 12, 10.0
"""How many times along a path the beam's direction is drawn, and how long, mm."""


@dataclass(frozen=True)
class Marked:
    """A picture and where in it each of T frames lies."""

    png: bytes
    places: np.ndarray
    """(T, 2) shares of the width from the left and of the height from the top; NaN if nowhere."""


def grades_figure(sweep: Sweep) -> Marked:
    """Draw the grade over time, shaded where the target view is shown."""
    places = np.full((sweep.frames, 2), np.nan)

    def draw() -> Figure:
        figure = Figure(figsize=(5.0, 2.5))
        axis = figure.add_axes((0.09, 0.22, 0.89, 0.63))
        _grades(axis, sweep)
        return figure

    def measure(figure: Figure) -> None:
        points = np.column_stack([sweep.times, np.zeros(sweep.frames)])
        places[:] = _shares(figure, figure.axes[0].transData.transform(points))

    return Marked(drawn(draw, measure), places)


def path_figure(sweep: Sweep) -> Marked | None:
    """Draw the path of the probe's tip and the beam along it; None where the data have no poses."""
    parameters = sweep.store.parameters[sweep.rows].double()
    if not parameters[:, 6:].isfinite().all():
        return None
    pose = parameters_to_pose(parameters)
    tip, beam = 1e3 * pose.position.numpy(), pose.rotation[..., 2].numpy()
    places = np.full((sweep.frames, 2), np.nan)

    def draw() -> Figure:
        figure = Figure(figsize=(5.0, 3.9))
        axis = figure.add_axes((0.0, 0.02, 0.93, 0.90), projection="3d")
        assert isinstance(axis, Axes3D)
        _path(axis, sweep, tip, beam)
        return figure

    def measure(figure: Figure) -> None:
        axis = figure.axes[0]
        assert isinstance(axis, Axes3D)
        x, y, z = tip.T
        flat = np.column_stack(proj_transform(x, y, z, axis.get_proj())[:2])
        places[:] = _shares(figure, axis.transData.transform(flat))

    return Marked(drawn(draw, measure), places)


def _grades(axis: Axes, sweep: Sweep) -> None:
    store, rows = sweep.store, sweep.rows
    labels, grades, views = store.labels, store.grades[rows].numpy(), store.views[rows].numpy()
    colour = view_colours(labels).get(sweep.target_view, MUTED)
    if sweep.target_view in labels[:-1]:
        aimed = views == labels.index(sweep.target_view)
        axis.fill_between(sweep.times, 0, 10, where=aimed, color=colour, alpha=0.15, lw=0)
    axis.plot(sweep.times, grades, color=colour, lw=1.6)
    if not np.isfinite(grades).any():
        axis.text(0.5, 0.5, "the data have no grades", transform=axis.transAxes, ha="center")
    axis.set_ylim(0, 10)
    axis.set_yticks((0, 5, 10))
    axis.margins(x=0.01)
    axis.set_xlabel("time, s" if sweep.timed else "frame")
    axis.set_title(f"Grade; shaded: {sweep.target_view} in view")


def _path(axis: Axes3D, sweep: Sweep, tip: np.ndarray, beam: np.ndarray) -> None:
    colour = view_colours(sweep.store.labels).get(sweep.target_view, MUTED)
    axis.set_proj_type("persp", focal_length=0.6)
    axis.view_init(elev=28, azim=-58)
    top = block_top(sweep.store.manifest)
    if top is not None:
        face: dict[str, Any] = {"facecolor": "#d9c7a8", "edgecolor": "#8c7a5b", "alpha": 0.3}
        axis.add_collection3d(Poly3DCollection([rectangle(*top)], **face))
    axis.plot(*tip.T, color=colour, lw=1.8)
    for i in evenly(len(tip), BEAMS):
        axis.plot(*np.stack([tip[i], tip[i] + BEAM * beam[i]]).T, color=MUTED, lw=0.9)
    axis.set_title("Probe's tip, mm; gray: the beam", pad=0)
    for letter in "xyz":
        getattr(axis, f"set_{letter}label")(letter, labelpad=-4)
        getattr(axis, f"{letter}axis").set_major_locator(MaxNLocator(4))
    axis.tick_params(pad=-1, labelsize=7.5)
    axis.set_box_aspect((1.2, 1.0, 0.62), zoom=1.05)  # pyright: ignore[reportArgumentType]


def _shares(figure: Figure, pixels: np.ndarray) -> np.ndarray:
    """Turn (T, 2) pixels from the bottom left into shares from the top left."""
    width, height = figure.bbox.size
    return np.column_stack([pixels[:, 0] / width, 1.0 - pixels[:, 1] / height])
