"""How the project's pictures look, and their bytes: equal on every draw, whatever the user's style.

All colours and letters of pictures are named here; other modules take them by name. Nothing of
pyplot is used, so no window system, global figure or user's matplotlibrc has a part. Charts alone
load matplotlib: who drives a probe by hand draws with Pillow.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from racines_data.files import image_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#1f2933", "#66727f", "#e4e8ec"
OURS, PAPER = "#4477aa", "#cc3311"
SPLIT_COLOURS = {"train": "#24527a", "validation": "#5b92c4", "test": "#a9cbe8"}
NO_VIEW, EDGE = "#5a646e", "#b8c1cb"
BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE, SKY, INDIGO, OLIVE = "#cc79a7", "#56b4e9", "#332288", "#999933"
_VIEWS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, INDIGO, OLIVE)
"""After Okabe and Ito (2008): told apart by the colour-blind too."""
STRENGTH_COLOURS = (SKY, BLUE, "#12304f")
"""Of what is mild, moderate, strong."""
YELLOW, VIOLET = "#f0e442", "#7c2bd6"
TISSUES = {
    "LV": VERMILION, "LV myocardium": GREEN, "LA": ORANGE, "RV": SKY, "RV wall": BLUE,
    "RA": INDIGO, "atrial wall": PURPLE, "aorta": YELLOW, "vessel wall": OLIVE,
    "mitral leaflet": "#ffffff", "tricuspid leaflet": "#ffffff", "aortic cusp": "#ffffff",
}  # fmt: skip
"""Colours of masks by the names of their labels."""
SAND, SAND_EDGE = "#d9c7a8", "#8c7a5b"
"""The top face of the phantom's block."""
AXES = {"x": VERMILION, "y": GREEN, "z": BLUE}
SHARES, LEVELS, SIGNED = "Blues", "cividis", "seismic"
"""Colour maps of shares of a whole, of all else that has a size, and of what is for or against."""

NIGHT, PANEL, LINE, PALE, WORDS = "#10161c", "#19222b", "#36434f", "#aebac5", "#edf1f4"
"""Dark pictures: ground, panels, lines, lesser words, words; as the boards' page at night."""
PROBE, TRUTH, PATH, WARNING, BELIEF = "#6cc4f5", "#00a878", YELLOW, "#f0803c", "#c4a1ff"
"""Signs on the dark, each read on a panel: those that meet are told apart by the colour-blind."""
SECTOR = "#1e4a63"
"""The plane that is looked through, on the dark."""

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": EDGE,
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
    "image.cmap": LEVELS,
    "figure.facecolor": "white",
    "figure.dpi": 110,
}
SMALL = 7.5
"""Points of the smallest letters in a chart: smaller ones are not read at half its size."""
_COLOURS = 128


@contextmanager
def card_style() -> Iterator[None]:
    """Draw in the project's style and leave the user's as it was."""
    import matplotlib
    from cycler import cycler

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        for name, value in {**_STYLE, "axes.prop_cycle": cycler(color=_VIEWS)}.items():
            matplotlib.rcParams[name] = value  # pyright: ignore[reportArgumentType]
        yield


@cache
def letters(size: int) -> Any:
    """Return the charts' letters, of `size` pixels, for Pillow; the same on every machine."""
    found = find_spec("matplotlib")
    assert found is not None and found.origin is not None
    file = Path(found.origin).parent / "mpl-data/fonts/ttf/DejaVuSans.ttf"
    # What else lays out letters is part of some builds of Pillow and not of others.
    return ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)


def colour(number: int) -> str:
    """Return the colour of a series by its number; they begin again after eight."""
    return _VIEWS[number % len(_VIEWS)]


def show_depth(
    axis: "Axes", height: float, mm: float, corner: tuple[float, float] | None = None,
    bar: float = 20.0,
) -> None:  # fmt: skip
    """Mark a square image of `height` units of `mm` each: a tick a cm of depth, longer each five.

    A bar of `bar` mm stands at the lower left, with its length. Depth is counted from the image's
    upper edge; where its upper left `corner` is not given, the image fills the axes.
    """
    left, top = (axis.get_xlim()[0], axis.get_ylim()[1]) if corner is None else corner
    right, look = left + height, {"color": "white", "fontsize": SMALL}
    for cm in range(1, int(height * mm / 10.0) + 1):
        long = height * (0.045 if cm % 5 == 0 else 0.02)
        row = top + 10.0 * cm / mm
        axis.plot([right - long, right], [row, row], color="white", linewidth=0.8)
        if cm % 5 == 0:
            axis.text(right - 1.2 * long, row, f"{cm}", ha="right", va="center", **look)
    y, start = top + 0.95 * height, left + 0.04 * height
    axis.plot([start, start + bar / mm], [y, y], color="white", linewidth=1.6)
    axis.text(start, y - 0.02 * height, f"{bar / 10:g} cm", va="bottom", **look)


def mark_depth(image: Image.Image, mm: float) -> None:
    """Mark an ultrasound image of pixels of `mm` at its right edge: a tick a cm, longer each five.

    The figures are cm of depth, counted from the image's upper edge.
    """
    draw, (width, height) = ImageDraw.Draw(image), image.size
    ink = ImageColor.getcolor(PALE, image.mode)
    size = max(11, width // 28)
    for cm in range(1, int(height * mm / 10.0) + 1):
        y, long = 10.0 * cm / mm, cm % 5 == 0
        left = width - width // (24 if long else 48)
        draw.line((left, y, width, y), ink, max(1, width // 300))
        if long and y < height - size:
            text = f"{cm} cm" if cm == 5 else f"{cm}"
            draw.text((left - 4, y), text, ink, letters(size), anchor="rm")


def view_colours(labels: Sequence[str]) -> dict[str, str]:
    """Return a colour for each view label; the last one, no view, is gray."""
    views = {name: _VIEWS[i % len(_VIEWS)] for i, name in enumerate(labels[:-1])}
    return {**views, labels[-1]: NO_VIEW}


def encode(
    figure: "Figure", gray: bool = False, few: bool = True, dpi: float | None = None
) -> bytes:
    """Return a figure as PNG without a date or a program's name, in gray, in few colours or all."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

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
