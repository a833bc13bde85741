"""The pictures of a card, drawn from the training store just before a dataset is sealed.

Here too are those of single frames: each view at several grades, and one view in many hearts.
"""

import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.card.columns import PIXELS_UNIT
from racines_data.card.frames import (
    CACTUS_COUNTS,
    Frames,
    card_statistics,
    has_paper,
    read_frames,
)
from racines_data.card.plots import parameters_figure, shares_figure, trajectories_figure
from racines_data.config import fill
from racines_data.geometry import POSITION
from racines_data.manifest import ADDED, MULTI_PHANTOM, is_turned, store_name
from racines_data.phantom.config import ProbeConfig
from racines_data.plotting import MUTED, SMALL, card_style, encode, evenly, show_depth
from racines_data.views import VIEW_TITLES

FOLDER = "card"
COLUMNS = 6
HEARTS = 24
HEARTS_ACROSS = 8
_IMAGE, _STEP, _MARGIN, _LINE = 1.42, 1.47, 1.18, 0.125
"""Inches: edge of a sample, from one to the next, column of the names, line of text."""
_LOOKED_AT = 400
"""Frames of no view among which those drawn are chosen by their brightness."""


def write_pictures(final: Path, manifest: dict[str, Any]) -> None:
    """Draw what there is to draw into `card/` of a dataset whose stores are written.

    Sets `manifest["statistics"]` (see `card_statistics`) and `manifest["pictures"]`, the names of
    the pictures drawn: `parameters`, `samples`, `shares`, `trajectories`, `hearts`. A dataset
    without poses has no `parameters` and `trajectories`, one without labels no `shares`.
    """
    frames = read_frames(final / store_name("frames"), manifest)
    statistics = manifest["statistics"] = card_statistics(frames)
    figures: dict[str, Callable[[], Figure | None]] = {
        "samples": partial(samples_figure, frames, pixel_of(manifest))
    }
    if statistics["parameters"]:
        paper = has_paper(manifest)
        figures["parameters"] = partial(parameters_figure, frames, statistics, paper)
    if (frames.views >= 0).any():
        cactus = frames.labels == tuple(CACTUS_COUNTS)
        figures["shares"] = partial(shares_figure, frames, statistics, cactus)
    if np.isfinite(frames.parameters[:, POSITION]).any() and not is_turned(manifest):
        figures["trajectories"] = partial(trajectories_figure, frames, manifest)
    if MULTI_PHANTOM in manifest["configs"]:
        hearts = read_frames(final / store_name(MULTI_PHANTOM), manifest)
        figures["hearts"] = partial(hearts_figure, hearts)
    with card_style():
        drawn = {name: draw(name, figure) for name, figure in figures.items()}
    pictures = {name: png for name, png in drawn.items() if png is not None}
    (final / FOLDER).mkdir(parents=True, exist_ok=True)
    for name, png in pictures.items():
        (final / FOLDER / f"{name}.png").write_bytes(png)
    manifest["pictures"] = list(pictures)


def draw(name: str, figure: Callable[[], Figure | None]) -> bytes | None:
    """Return the PNG of a picture; None where there is nothing to show."""
    made = figure()
    # Of colours over many grays few would be left: those of a mask would turn into each other.
    gray, few = name in ("samples", "hearts"), name not in ADDED
    return None if made is None else encode(made, gray=gray, few=few)


def samples_figure(frames: Frames, pixel: float | None = None) -> Figure:
    """Draw a row of frames for each view, from the best grade to the worst, with their values.

    Where the side of a `pixel` is known, mm, the first of each row has its depth.
    """
    rows = [
        (name, [(frames.images[row], _values(frames, row)) for row in chosen])
        for name, chosen in _sample_rows(frames)
    ]
    text = _LINE * max((len(values) for _, line in rows for _, values in line), default=0)
    step = _IMAGE + text + 0.12
    figure, axis = sheet(_MARGIN + COLUMNS * _STEP, step * len(rows))
    for number, (name, line) in enumerate(rows):
        top = step * number + 0.04
        axis.text(_MARGIN - 0.1, top, name, size=12, weight="bold", ha="right", va="top")
        title = textwrap.fill(VIEW_TITLES.get(name, ""), 16, break_on_hyphens=False)
        axis.text(_MARGIN - 0.1, top + 0.24, title, size=SMALL, color=MUTED, ha="right", va="top")
        for column, (image, values) in enumerate(line):
            left = _MARGIN + column * _STEP
            place(axis, image, left, top, _IMAGE)
            if pixel is not None and column == 0:
                show_depth(axis, _IMAGE, pixel * len(image) / _IMAGE, (left, top))
            for index, value in enumerate(values):
                weight = "bold" if value.startswith("grade") else "normal"
                below = top + _IMAGE + 0.03 + _LINE * index
                look = {"size": SMALL, "weight": weight, "ha": "center", "va": "top"}
                axis.text(left + _IMAGE / 2, below, value, **look)
    return figure


def pixel_of(manifest: dict[str, Any]) -> float | None:
    """Return the side of a pixel of the phantom's frames, mm; None of all else."""
    if manifest.get("source") != "phantom":
        return None
    settings = manifest.get("recipe", {}).get("settings", {})
    told = settings.get("acquisition", {}).get("phantom", {}).get("probe", {})
    return 1e3 * fill(ProbeConfig, told, "recipe.probe").pixel_size


def sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure and axes over the whole of it, in inches from its upper left corner."""
    figure = Figure(figsize=(width, height))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_axis_off()
    axis.set(xlim=(0, width), ylim=(height, 0), autoscale_on=False)
    return figure, axis


def place(axis: Axes, image: np.ndarray, left: float, top: float, edge: float) -> None:
    """Put a picture, (H, W) gray or (H, W, 3), at a place of a sheet, in inches."""
    gray = {"cmap": "gray", "vmin": 0, "vmax": 255, "interpolation": "bilinear"}
    axis.imshow(image, extent=(left, left + edge, top + edge, top), aspect="auto", **gray)


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
        scale, unit = (1e3, "mm") if frames.scaled else (1.0, PIXELS_UNIT)
        place = (scale * p[6:9]).round() + 0.0
        lines.append("pos {:.0f}, {:.0f}, {:.0f} {unit}".format(*place, unit=unit))
        lines.append("rot {:.0f}°, {:.0f}°, {:.0f}°".format(*np.degrees(p[9:]).round() + 0.0))
    if np.isfinite(p[:3]).all():
        lines.append("force {:.1f}, {:.1f}, {:.1f} N".format(*p[:3]))
    return [line.replace("-", "−") for line in lines]


def hearts_figure(frames: Frames) -> Figure | None:
    """Draw the best frame of the first view from up to HEARTS hearts; None where none shows it."""
    seed = np.array([-1 if each is None else each for each in frames.phantoms])[frames.trajectory]
    shown = np.flatnonzero((frames.views == 0) & np.isfinite(frames.grades))
    if not len(shown):
        return None
    shown = shown[np.lexsort((-frames.grades[shown], seed[shown]))]  # each heart's best first
    hearts, first = np.unique(seed[shown], return_index=True)
    best = list(zip(hearts, shown[first], strict=True))
    whole = max(len(best) // HEARTS_ACROSS * HEARTS_ACROSS, min(len(best), HEARTS_ACROSS))
    best = [best[i] for i in evenly(len(best), min(whole, HEARTS))]  # full rows
    across = min(HEARTS_ACROSS, len(best))
    edge, gap, head = 1.22, 0.03, 0.17
    figure, axis = sheet(across * (edge + gap), -(-len(best) // across) * (edge + head))
    for number, (each, row) in enumerate(best):
        left, top = number % across * (edge + gap), number // across * (edge + head) + head
        place(axis, frames.images[row], left, top, edge)
        title = f"heart {each}, grade {frames.grades[row]:.1f}"
        axis.text(left + edge / 2, top - 0.03, title, size=SMALL, ha="center", va="bottom")
    return figure
