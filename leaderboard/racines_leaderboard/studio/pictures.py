"""Pictures inside a page, as data: no file is written that another visitor could fetch."""

import base64
import io
import threading
from collections.abc import Callable

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from racines_data.plotting import card_style
from racines_leaderboard.studio.html import text

DPI = 180
"""Of figures: about twice a screen's, so that their text stays sharp."""
_drawing = threading.Lock()
"""Matplotlib's settings belong to the process: one figure at a time."""


def drawn(draw: Callable[[], Figure], after: Callable[[Figure], None] | None = None) -> bytes:
    """Draw a figure in the house style and return it as PNG; `after` may measure it."""
    with _drawing, card_style():
        figure = draw()
        figure.set_dpi(DPI)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        if after is not None:
            after(figure)
        pixels = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    return _png(pixels.quantize(128, dither=Image.Dither.NONE))


def image_png(image: np.ndarray) -> bytes:
    """Return an (H, W) or (H, W, 3) uint8 image as PNG."""
    return _png(Image.fromarray(image))


def element(png: bytes, alt: str, css: str = "rc-chart", style: str = "") -> str:
    """Return a PNG as an HTML image; `css` and `style` are ours, `alt` may be anybody's."""
    data = base64.b64encode(png).decode()
    styled = f' style="{style}"' if style else ""
    return f'<img class="{css}"{styled} alt="{text(alt)}" src="data:image/png;base64,{data}">'


def ultrasound(png: bytes, alt: str) -> str:
    """Return an ultrasound image as HTML, on black, as large as its place allows."""
    return f'<div class="rc-scan">{element(png, alt, "rc-frame")}</div>'


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()
