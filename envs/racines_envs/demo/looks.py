"""Colours and letters that the page, the film and the map share."""

from functools import cache
from typing import Any

from PIL import ImageFont

BACK, PANEL, LINE, PALE, WORDS = "#0f1419", "#182029", "#3d4854", "#a9b4bf", "#eef2f5"
INK, LABEL, PAPER = "#11161c", "#5a3a2b", "#ffffff"
SKIN = (226, 180, 152)
PROBE, AIM, TRUE, WAY = "#38bdf8", "#7c2bd6", "#22c55e", "#14639c"
READ, GOOD, BAD, NAME = "#c4a1ff", "#4ade80", "#fbbf24", "#ffe08a"


@cache
def font(size: int) -> Any:
    """Return letters of so many pixels."""
    return ImageFont.load_default(size)
