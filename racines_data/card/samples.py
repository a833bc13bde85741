"""Frames of a card: each view at several grades with its values, and one view in many hearts."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.card.frames import Frames
from racines_data.plotting import MUTED, evenly
from racines_data.views import VIEW_TITLES

COLUMNS = 6
HEARTS = 24
HEARTS_ACROSS = 8
_IMAGE, _STEP, _MARGIN, _LINE = 1.42, 1.47, 1.18, 0.125
"""Inches: edge of a sample, from one to the next, column of the names, line of text."""
_LOOKED_AT = 400
"""Frames of no view among which those drawn are chosen by their brightness."""


def samples_figure(frames: Frames) -> Figure:
    """Draw a row of frames for each view, from the best grade to the worst, with their values."""
    rows = [
        (name, [(frames.images[row], _values(frames, row)) for row in chosen])
        for name, chosen in _sample_rows(frames)
    ]
    text = _LINE * max((len(values) for _, line in rows for _, values in line), default=0)
    step = _IMAGE + text + 0.12
    figure, axis = _sheet(_MARGIN + COLUMNS * _STEP, step * len(rows))
    for number, (name, line) in enumerate(rows):
        top = step * number + 0.04
        axis.text(_MARGIN - 0.1, top, name, size=12, weight="bold", ha="right", va="top")
        title = textwrap.fill(VIEW_TITLES.get(name, ""), 16, break_on_hyphens=False)
        axis.text(_MARGIN - 0.1, top + 0.24, title, size=7.5, color=MUTED, ha="right", va="top")
        for column, (image, values) in enumerate(line):
            left = _MARGIN + column * _STEP
            _place(axis, image, left, top, _IMAGE)
            for index, value in enumerate(values):
                weight = "bold" if value.startswith("grade") else "normal"
                below = top + _IMAGE + 0.03 + _LINE * index
                axis.text(
                    left + _IMAGE / 2, below, value, size=7.2, weight=weight, ha="center", va="top"
                )
    return figure


def _sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure and axes over the whole of it, in inches from its upper left corner."""
    figure = Figure(figsize=(width, height))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_axis_off()
    axis.set_xlim(0, width)
    axis.set_ylim(height, 0)
    axis.set_autoscale_on(False)
    return figure, axis


def _place(axis: Axes, image: np.ndarray, left: float, top: float, edge: float) -> None:
    place = (left, left + edge, top + edge, top)
    axis.imshow(
        image, cmap="gray", vmin=0, vmax=255, extent=place, interpolation="bilinear", aspect="auto"
    )


def _sample_rows(frames: Frames) -> list[tuple[str, np.ndarray]]:
    """Return each label with its rows; frames without labels stand under their target view."""
    groups: list[tuple[str, np.ndarray]] = [
        (name, np.flatnonzero(frames.views == label)) for label, name in enumerate(frames.labels)
    ]
    if not any(len(rows) for _, rows in groups):
        target = np.array(frames.target_views)[frames.trajectory]
        groups = [(name, np.flatnonzero(target == name)) for name in dict.fromkeys(target)]
    return [(name, _by_grade(frames, rows)) for name, rows in groups if len(rows)]


def _by_grade(frames: Frames, rows: np.ndarray) -> np.ndarray:
    """Return up to COLUMNS rows: evenly down the range of grades, else of brightness."""
    graded = rows[np.isfinite(frames.grades[rows])]
    known = frames.grades[graded]
    if not len(graded) or known.min() == known.max():
        some = rows[evenly(len(rows), _LOOKED_AT)]
        order = frames.images[some].mean((1, 2)).argsort(kind="stable")[::-1]
        return some[order][evenly(len(order), COLUMNS)]
    wanted = np.linspace(known.max(), known.min(), COLUMNS)
    nearest = [int(np.abs(known - grade).argmin()) for grade in wanted]
    return graded[list(dict.fromkeys(nearest))]


def _values(frames: Frames, row: int) -> list[str]:
    """Return what is known of a frame, a line each: grade, position, rotation, force."""
    grade, p = float(frames.grades[row]), frames.parameters[row].astype(float)
    p[:3] = p[:3].round(1) + 0.0  # no minus before a zero
    lines = [] if np.isnan(grade) else [f"grade {grade:.1f}"]
    if np.isfinite(p[6:9]).all():
        lines.append("pos {:.0f}, {:.0f}, {:.0f} mm".format(*((1e3 * p[6:9]).round() + 0.0)))
        lines.append("rot {:.0f}°, {:.0f}°, {:.0f}°".format(*np.degrees(p[9:]).round() + 0.0))
    if np.isfinite(p[:3]).all():
        lines.append("force {:.1f}, {:.1f}, {:.1f} N".format(*p[:3]))
    return [line.replace("-", "−") for line in lines]


def hearts_figure(frames: Frames) -> Figure | None:
    """Draw the best frame of the first view from up to HEARTS hearts; None where none shows it."""
    seed = np.array([-1 if each is None else each for each in frames.phantoms])[frames.trajectory]
    shown = (frames.views == 0) & np.isfinite(frames.grades)
    best = []
    for each in np.unique(seed[shown]):
        rows = np.flatnonzero((seed == each) & shown)
        best.append((each, rows[frames.grades[rows].argmax()]))
    if not best:
        return None
    whole = max(len(best) // HEARTS_ACROSS * HEARTS_ACROSS, min(len(best), HEARTS_ACROSS))
    best = [best[i] for i in evenly(len(best), min(whole, HEARTS))]  # full rows
    across = min(HEARTS_ACROSS, len(best))
    edge, gap, head = 1.22, 0.03, 0.17
    figure, axis = _sheet(across * (edge + gap), -(-len(best) // across) * (edge + head))
    for number, (each, row) in enumerate(best):
        left, top = number % across * (edge + gap), number // across * (edge + head) + head
        _place(axis, frames.images[row], left, top, edge)
        title = f"heart {each}, grade {frames.grades[row]:.1f}"
        axis.text(left + edge / 2, top - 0.03, title, size=7.5, ha="center", va="bottom")
    return figure
