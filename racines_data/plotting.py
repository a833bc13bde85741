"""How the project's pictures look, and their bytes: equal on every draw, whatever the user's style.

Nothing of pyplot is used, so no window system, global figure or user's matplotlibrc has a part.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from racines_data.files import image_bytes

INK, MUTED, GRID = "#1f2933", "#66727f", "#e4e8ec"
OURS, PAPER = "#4477aa", "#cc3311"
SPLIT_COLOURS = {"train": "#24527a", "validation": "#5b92c4", "test": "#a9cbe8"}
NO_VIEW = "#9aa5b1"
_VIEWS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#332288", "#999933")
"""After Okabe and Ito (2008): told apart by the colour-blind too."""

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b8c1cb",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "axes.prop_cycle": cycler(color=_VIEWS),
    "image.cmap": "cividis",
    "figure.facecolor": "white",
    "figure.dpi": 110,
}
_COLOURS = 128


@contextmanager
def card_style() -> Iterator[None]:
    """Draw in the card's style and leave the user's as it was."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        for name, value in _STYLE.items():
            matplotlib.rcParams[name] = value  # pyright: ignore[reportArgumentType]
        yield


def colour(number: int) -> str:
    """Return the colour of a series by its number; they begin again after eight."""
    return _VIEWS[number % len(_VIEWS)]


def show_depth(axis: Axes, height: int, mm: float, bar: float = 20.0, ink: str = "white") -> None:
    """Mark an image of `height` rows of `mm` each: a tick a cm of depth, longer each five, a bar.

    The bar is `bar` mm long and stands at the lower left, with its length. Depth is counted from
    the image's upper edge.
    """
    right = axis.get_xlim()[1]
    for cm in range(1, int(height * mm / 10.0) + 1):
        long = 0.045 if cm % 5 == 0 else 0.02
        row = 10.0 * cm / mm
        axis.plot([right * (1 - long), right], [row, row], color=ink, linewidth=0.8)
        if cm % 5 == 0:
            axis.text(right * 0.945, row, f"{cm}", color=ink, fontsize=6, ha="right", va="center")
    y, left = 0.95 * height, 0.04 * height
    axis.plot([left, left + bar / mm], [y, y], color=ink, linewidth=1.6)
    axis.text(left, y - 0.02 * height, f"{bar / 10:g} cm", color=ink, fontsize=6, va="bottom")


def view_colours(labels: Sequence[str]) -> dict[str, str]:
    """Return a colour for each view label; the last one, no view, is gray."""
    views = {name: _VIEWS[i % len(_VIEWS)] for i, name in enumerate(labels[:-1])}
    return {**views, labels[-1]: NO_VIEW}


def encode(figure: Figure, gray: bool = False, few: bool = True, dpi: float | None = None) -> bytes:
    """Return a figure as PNG without a date or a program's name, in gray, in few colours or all."""
    if dpi is not None:
        figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    if gray:
        picture = picture.convert("L")
    elif few:
        picture = picture.quantize(_COLOURS, dither=Image.Dither.NONE)
    return image_bytes(picture, optimize=True)


def evenly(count: int, wanted: int) -> np.ndarray:
    """Return `wanted` rows of `count` at even distances, first and last among them."""
    return np.linspace(0, count - 1, min(count, wanted)).round().astype(np.int64)
