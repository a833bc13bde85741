"""Frames of a card: each view at several grades with its values, and one view in many hearts."""

import textwrap

import numpy as np
from matplotlib.figure import Figure

from racines_data.card_frames import Frames
from racines_data.card_style import MUTED, evenly, show_image
from racines_data.views import VIEW_TITLES

COLUMNS = 6
HEARTS = 24
HEARTS_ACROSS = 8
_IMAGE, _MARGIN = 1.42, 1.18
"""Edge of a sample and width of the names' column, inches."""
_LOOKED_AT = 400
"""Frames of no view among which those drawn are chosen by their brightness."""


def samples_figure(frames: Frames) -> Figure:
    """Draw a row of frames for each view, from the best grade to the worst, with their values."""
    rows = _sample_rows(frames)
    lines = max((len(_values(frames, row)) for _, chosen in rows for row in chosen), default=0)
    text = 0.04 + 0.125 * lines  # inches below an image
    width, height = 10.0, (_IMAGE + text + 0.08) * len(rows)
    figure = Figure(figsize=(width, height))
    for line, (name, chosen) in enumerate(rows):
        top = 1.0 - ((_IMAGE + text + 0.08) * line + 0.04) / height
        for column, row in enumerate(chosen):
            left = (_MARGIN + column * (width - _MARGIN) / COLUMNS) / width
            box = (left, top - _IMAGE / height, _IMAGE / width, _IMAGE / height)
            axis = figure.add_axes(box)
            show_image(axis, frames.images[row])
            middle = left + _IMAGE / width / 2
            for number, value in enumerate(_values(frames, row)):
                figure.text(
                    middle, box[1] - (0.03 + 0.125 * number) / height, value, ha="center",
                    va="top", size=7.2, weight="bold" if value.startswith("grade") else "normal",
                )  # fmt: skip
        edge = (_MARGIN - 0.1) / width
        figure.text(edge, top, name, size=12, weight="bold", ha="right", va="top")
        title = textwrap.fill(VIEW_TITLES.get(name, ""), 16, break_on_hyphens=False)
        below = top - 0.24 / height
        figure.text(edge, below, title, size=7.5, color=MUTED, ha="right", va="top")
    return figure


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
    best = [best[i] for i in evenly(len(best), HEARTS)]
    lines = -(-len(best) // HEARTS_ACROSS)
    figure = Figure(figsize=(10.0, 1.44 * lines))
    axes = figure.subplots(lines, HEARTS_ACROSS, squeeze=False).flat
    for axis in axes:
        axis.set_axis_off()
    for axis, (each, row) in zip(axes, best, strict=False):
        show_image(axis, frames.images[row])
        title = f"heart {each}, grade {frames.grades[row]:.1f}"
        axis.set_title(title, size=7.5, loc="center", pad=2, weight="normal")
    top = 1.0 - 0.17 / figure.get_figheight()
    figure.subplots_adjust(0.002, 0.004, 0.998, top, wspace=0.03, hspace=0.15)
    return figure
