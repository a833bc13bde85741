"""A trajectory and a frame of it as HTML: image, labels, parameters, and figures with a mark.

Each figure is drawn once a trajectory; where in it a frame lies is told in shares of its width and
height, so that a page can move a mark over the picture instead of drawing it again.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from racines_data.card.plots import block_top, rectangle
from racines_data.geometry import parameters_to_pose
from racines_data.plotting import MUTED, evenly, view_colours
from racines_data.schema import PARAMETERS
from racines_leaderboard.studio.browsing import Trajectory
from racines_leaderboard.studio.html import table, text
from racines_leaderboard.studio.pictures import drawn, element, image_png, ultrasound
from racines_leaderboard.studio.shared import Shared

BEAMS, BEAM = 12, 10.0
"""How many times along a path the beam's direction is drawn, and how long, mm."""


@dataclass(frozen=True)
class Marked:
    """A picture and where in it each of T frames lies."""

    png: bytes
    places: np.ndarray
    """(T, 2) shares of the width from the left and of the height from the top; NaN if nowhere."""


def grades_figure(trajectory: Trajectory) -> Marked:
    """Draw the grade over time, shaded where the target view is shown."""
    places = np.full((trajectory.frames, 2), np.nan)

    def draw() -> Figure:
        figure = Figure(figsize=(5.0, 2.5))
        axis = figure.add_axes((0.09, 0.22, 0.89, 0.63))
        _grades(axis, trajectory)
        return figure

    def measure(figure: Figure) -> None:
        points = np.column_stack([trajectory.times, np.zeros(trajectory.frames)])
        places[:] = _shares(figure, figure.axes[0].transData.transform(points))

    return Marked(drawn(draw, measure), places)


def path_figure(trajectory: Trajectory) -> Marked | None:
    """Draw the path of the probe's tip and the beam along it; None where the data have no poses."""
    parameters = trajectory.store.parameters[trajectory.rows].double()
    if not parameters[:, 6:].isfinite().all():
        return None
    pose = parameters_to_pose(parameters)
    tip, beam = 1e3 * pose.position.numpy(), pose.rotation[..., 2].numpy()
    places = np.full((trajectory.frames, 2), np.nan)

    def draw() -> Figure:
        figure = Figure(figsize=(5.0, 3.9))
        axis = figure.add_axes((0.0, 0.02, 0.93, 0.90), projection="3d")
        assert isinstance(axis, Axes3D)
        _path(axis, trajectory, tip, beam)
        return figure

    def measure(figure: Figure) -> None:
        axis = figure.axes[0]
        assert isinstance(axis, Axes3D)
        x, y, z = tip.T
        flat = np.column_stack(proj_transform(x, y, z, axis.get_proj())[:2])
        places[:] = _shares(figure, axis.transData.transform(flat))

    return Marked(drawn(draw, measure), places)


def _grades(axis: Axes, trajectory: Trajectory) -> None:
    store, rows = trajectory.store, trajectory.rows
    labels, grades, views = store.labels, store.grades[rows].numpy(), store.views[rows].numpy()
    colour = view_colours(labels).get(trajectory.target_view, MUTED)
    if trajectory.target_view in labels[:-1]:
        aimed = views == labels.index(trajectory.target_view)
        axis.fill_between(trajectory.times, 0, 10, where=aimed, color=colour, alpha=0.15, lw=0)
    axis.plot(trajectory.times, grades, color=colour, lw=1.6)
    if not np.isfinite(grades).any():
        axis.text(0.5, 0.5, "the data have no grades", transform=axis.transAxes, ha="center")
    axis.set_ylim(0, 10)
    axis.set_yticks((0, 5, 10))
    axis.margins(x=0.01)
    axis.set_xlabel("time, s" if trajectory.timed else "frame")
    axis.set_title(f"Grade; shaded: {trajectory.target_view} in view")


def _path(axis: Axes3D, trajectory: Trajectory, tip: np.ndarray, beam: np.ndarray) -> None:
    colour = view_colours(trajectory.store.labels).get(trajectory.target_view, MUTED)
    axis.set_proj_type("persp", focal_length=0.6)
    axis.view_init(elev=28, azim=-58)
    top = block_top(trajectory.store.manifest)
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


UNITS = {"force": "N", "torque": "N·m", "position": "mm", "rotation": "°"}
SCALES = {"position": 1e3, "rotation": 180.0 / math.pi}
"""From the data's SI units to those that are shown."""


def image_html(trajectory: Trajectory, frame: int) -> str:
    """Return a frame's image on black, with its view and grade below."""
    row = trajectory.first + frame
    store = trajectory.store
    label, grade = int(store.views[row]), float(store.grades[row])
    view = store.labels[label] if label >= 0 else "view unknown"
    graded = f"grade {grade:.1f}" if math.isfinite(grade) else "no grade"
    seconds = f", {trajectory.times[frame]:.2f} s" if trajectory.timed else ""
    caption = f"{view}, {graded} · frame {frame + 1} of {trajectory.frames}{seconds}"
    source = store.manifest["source"]
    simulated = "simulated" if source == "phantom" else f"source: {source}"
    picture = ultrasound(image_png(store.images[row].numpy()), caption)
    return f'{picture}<p class="rc-note">{text(caption)} · {text(simulated)}</p>'


def facts_html(trajectory: Trajectory) -> str:
    """Return what a trajectory is."""
    seconds = f", {trajectory.times[-1]:.1f} s" if trajectory.timed else ""
    manifest = trajectory.store.manifest
    facts = (
        f"{trajectory.name}: {trajectory.split} split, aimed at {trajectory.target_view}, session "
        f"{trajectory.session}, {trajectory.frames} frames{seconds}. Data: {manifest['source']} "
        f"{manifest['version']}, digest {manifest['digest'][:12]}."
    )
    return f'<p class="rc-note">{text(facts)}</p>'


def parameters_html(trajectory: Trajectory, frame: int) -> str:
    """Return the twelve parameters of a frame as a table."""
    values = trajectory.store.parameters[trajectory.first + frame].tolist()
    named: dict[str, float] = dict(zip(PARAMETERS, values, strict=True))
    rows = []
    for kind, unit in UNITS.items():
        scale = SCALES.get(kind, 1.0)
        cells = (_number(scale * named[f"{kind}_{axis}"]) for axis in "xyz")
        rows.append((f"{kind}, {unit}", *cells))
    return table(("", *"xyz"), rows, ("rc-text", "", "", ""))


def figures_html(trajectory: Trajectory, frame: int) -> str:
    """Return the grade over time and the path in 3-D, with a mark at the frame."""
    grades, path = _figures(trajectory)
    left = f"{100 * grades.places[frame, 0]:.2f}%"
    cursor = f'<div class="rc-cursor" style="left:{left};top:15%;height:63%"></div>'
    pictures = [f'<div class="rc-over">{element(grades.png, "grade over time")}{cursor}</div>']
    if path is not None:
        x, y = 100 * path.places[frame]
        dot = f'<div class="rc-dot" style="left:{x:.2f}%;top:{y:.2f}%"></div>'
        pictures.append(f'<div class="rc-over">{element(path.png, "path of the probe")}{dot}</div>')
    return "".join(pictures)


_drawings: Shared[tuple[Marked, Marked | None]] = Shared(64)


def _figures(trajectory: Trajectory) -> tuple[Marked, Marked | None]:
    return _drawings.get(trajectory, lambda: (grades_figure(trajectory), path_figure(trajectory)))


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
