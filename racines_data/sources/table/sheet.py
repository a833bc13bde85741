"""The sheet of a recording: the probe's frame along the sweep, steps, frames, histograms, words.

+---------------------+----------------------+
| probe's frame, 3-D  | distance a row       |
|                     | angle a row, degrees |
+---------------------+----------------------+
| six frames of the first sweep              |
+--------------------------------------------+
| histograms: x y z, step of time, gray      |
+--------------------------------------------+
| what looks wrong, in words                 |
"""

import textwrap
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from racines_data.plotting import AXES, INK, MUTED, OURS, PAPER, card_style, encode, evenly
from racines_data.sources.table.inspecting import SHOWN, Inspection

_Rectangle = tuple[float, float, float, float]
_Place = Callable[[float, float, float, float], _Rectangle]
_NAMES = {"x": "right of the image", "y": "out of it", "z": "along the beam"}
_TRIADS, _POINTS = 12, 2000
_WIDTH, _LETTERS = 13.0, 150
_LINES = 14
"""Lines of words, at most."""


def draw_sheet(made: Inspection, title: str) -> bytes:
    """Return the sheet as PNG.

    Args:
        made: What a mapping makes of a folder.
        title: Said above it.
    """
    words = _wrapped(made)
    with card_style():
        figure = Figure(figsize=(_WIDTH, 10.2 + 0.19 * len(words)))
        high = figure.get_figheight()

        def place(left: float, top: float, wide: float, tall: float) -> _Rectangle:
            return left / _WIDTH, 1 - (top + tall) / high, wide / _WIDTH, tall / high

        figure.text(0.3 / _WIDTH, 1 - 0.35 / high, title, size=12, weight="bold")
        figure.text(0.3 / _WIDTH, 1 - 0.58 / high, _told(made), size=9, color=MUTED)
        figure.text(
            0.35 / _WIDTH, 1 - 0.9 / high, "probe's frame along the sweep", size=9.5, weight="bold"
        )
        _path(figure, place(0.3, 0.75, 5.9, 4.6), made)
        _steps(figure, [place(7.2, 0.95, 5.5, 1.75), place(7.2, 3.35, 5.5, 1.75)], made)
        _shown(figure, made, place)
        _histograms(figure, [place(0.75 + 2.52 * i, 8.15, 1.95, 1.35) for i in range(5)], made)
        for line, (text, colour) in enumerate(words):
            down = 1 - (10.15 + 0.19 * line) / high
            figure.text(0.3 / _WIDTH, down, text, size=8.5, color=colour)
        return encode(figure, few=False)


def _told(made: Inspection) -> str:
    rows = sum(len(draft.rows) for draft in made.drafts)
    return (
        f"{rows} rows in {len(made.drafts)} sweep(s), {made.frames} frames sound; shown: "
        f"{made.drafts[0].name}; histograms: all"
    )


def _wrapped(made: Inspection) -> list[tuple[str, str]]:
    told = made.words()
    if not told:
        return [("Nothing looks wrong.", INK)]
    lines = [("What looks wrong:", INK)]
    for each in told:
        for number, text in enumerate(textwrap.wrap(each, _LETTERS)):
            lines.append((("• " if number == 0 else "   ") + text, PAPER))
    return lines[:_LINES] + ([("…", PAPER)] if len(lines) > _LINES else [])


def _path(figure: Figure, place: _Rectangle, made: Inspection) -> None:
    """Draw the path of the probe, and its three axes at a few places."""
    axis = figure.add_axes(place, projection="3d")
    assert isinstance(axis, Axes3D)
    poses = made.poses[0]
    poses = poses[np.isfinite(poses).all((1, 2))]
    if not len(poses):
        axis.text2D(0.5, 0.5, "no row has a whole pose", transform=axis.transAxes, ha="center")
        return
    tips = 1e3 * poses[evenly(len(poses), _POINTS), :3, 3]
    span = max(float(np.ptp(tips, axis=0).max()), 1.0)
    axis.plot(*tips.T, color=MUTED, lw=1.2)
    for row in evenly(len(poses), _TRIADS):
        start = 1e3 * poses[row, :3, 3]
        for number, colour in enumerate(AXES.values()):
            end = start + 0.16 * span * poses[row, :3, number]
            axis.plot(*np.stack([start, end]).T, color=colour, lw=1.8)
    axis.scatter(*tips[:1].T, color=INK, s=22)
    middle, ends = (tips.max(0) + tips.min(0)) / 2, 0.6 * span * np.array([-1, 1])
    axis.set(xlim=middle[0] + ends, ylim=middle[1] + ends, zlim=middle[2] + ends)
    for letter in "xyz":
        getattr(axis, f"set_{letter}label")(
            f"{letter}, {made.unit}", labelpad=5 if letter == "z" else 2
        )
    axis.tick_params(pad=1, labelsize=7)
    axis.zaxis.set_tick_params(pad=5)
    axis.locator_params(nbins=5)
    told = _NAMES if made.imaged else dict.fromkeys("xyz", "of what is tracked")
    for number, (letter, text) in enumerate(told.items()):
        down, colour = 0.91 - 0.045 * number, AXES[letter]
        axis.text2D(-0.03, down, f"{letter}: {text}", transform=axis.transAxes, color=colour)
    axis.text2D(-0.03, 0.77, "• first row", transform=axis.transAxes, color=INK)


def _steps(figure: Figure, places: Sequence[_Rectangle], made: Inspection) -> None:
    """Draw how far and by how much the probe moves and turns from row to row."""
    poses = made.poses[0]
    moved = 1e3 * np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turns = np.einsum("tij,tij->t", poses[1:, :3, :3], poses[:-1, :3, :3])
    turned = np.degrees(np.arccos(np.clip((turns - 1) / 2, -1, 1)))
    told = (
        ("distance from row to row", made.unit, moved),
        ("angle from row to row", "degrees", turned),
    )
    for place, (title, unit, values) in zip(places, told, strict=True):
        axis = figure.add_axes(place)
        axis.plot(np.arange(1, len(values) + 1), values, color=OURS, lw=1.1)
        usual = f"median {np.nanmedian(values):.3g} {unit}" if np.isfinite(values).any() else ""
        axis.set_title(f"{title}; {usual}" if usual else title)
        axis.set(ylabel=unit, xlabel="row")
        axis.set_ylim(bottom=0)


def _shown(figure: Figure, made: Inspection, place: _Place) -> None:
    for number in range(SHOWN):
        axis = figure.add_axes(place(0.35 + 2.1 * number, 5.75, 1.95, 1.95))
        axis.set_axis_off()
        if number < len(made.images):
            name, image = made.images[number]
            axis.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axis.set_title(name, fontweight="normal", loc="center", pad=2)
    if not made.images:
        text = "no images: see below"
        figure.text(0.5, place(0, 5.75, 1, 1)[1], text, ha="center", color=MUTED)


def _histograms(figure: Figure, places: Sequence[_Rectangle], made: Inspection) -> None:
    tips = 1e3 * np.concatenate(made.poses)[:, :3, 3]
    steps = np.concatenate([np.diff(draft.times) for draft in made.drafts])
    told = [(f"position {'xyz'[i]}", made.unit, tips[:, i]) for i in range(3)]
    told.append(("step of time", "ms", 1e3 * steps))
    grays = [image.ravel() for _, image in made.images]
    told.append(("gray, not black", "level", np.concatenate(grays) if grays else np.empty(0)))
    for place, (title, unit, values) in zip(places, told, strict=True):
        axis = figure.add_axes(place)
        values = values[np.isfinite(values)]
        _histogram(axis, values[values > 0] if unit == "level" else values)
        axis.set_title(title)
        axis.set_xlabel(unit, labelpad=1)
        axis.set_ylabel("%" if not place[0] > 0.1 else "", labelpad=1)


def _histogram(axis: Axes, values: np.ndarray) -> None:
    if not len(values):
        axis.text(0.5, 0.5, "none", transform=axis.transAxes, ha="center", color=MUTED)
        return
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9 * max(abs(low), abs(high), 1e-9):
        low, high = low - 0.5, high + 0.5
    counts, edges = np.histogram(values, 40, (low, high))
    axis.stairs(100 * counts / len(values), edges, fill=True, color=OURS, alpha=0.75)
    axis.locator_params(nbins=4)
