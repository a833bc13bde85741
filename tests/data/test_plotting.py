"""One style for all pictures: colours and letters by name, told apart, the same everywhere."""

import ast
import re
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from racines_data import plotting
from racines_data.plotting import SMALL, card_style, encode, letters, mark_depth, show_depth
from tests.conftest import ROOT
from tests.modules import modules

STYLE = "racines_data.plotting"
EXCEPTIONS = {
    "racines_envs.demo.chestmap": "skin, bone and the red and blue heart of an atlas",
    "racines_leaderboard.studio.app": "the theme's grounds, those of the boards' page by day",
}
"""Modules that may name colours of their own, and which."""
PAGES = ROOT / "leaderboard/racines_leaderboard/board/web/page.css"
"""The palette of pages that are read by day and by night: darker for words on white."""
HEX = re.compile(r"#(?:[0-9a-fA-F]{3}){1,2}\b")
PAINTED = {
    "color", "colors", "c", "ec", "fc", "facecolor", "edgecolor", "ecolor", "labelcolor", "fill",
    "outline", "stroke_fill", "markerfacecolor", "markeredgecolor", "hatchcolor",
}  # fmt: skip
PLAIN = {"white", "black", "none", "face"}
MAPS = {"gray"}
LEAST = 7.0
"""Points of letters."""


def own_looks(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and kind of each colour, font and setting that a drawing module names."""
    tree = ast.parse(source)
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("load_default", "truetype"):
            yield node.lineno, f"font: {node.attr}"
        if isinstance(node, ast.Attribute) and node.attr in (
            "rcParams",
            "rc_context",
            "rcdefaults",
        ):
            yield node.lineno, node.attr
        if isinstance(node, ast.ImportFrom | ast.Import):
            named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            named += [alias.name for alias in node.names]
            if {"matplotlib.pyplot", "pyplot", "rcParams", "ImageFont"} & set(named):
                yield node.lineno, f"import: {', '.join(named)}"
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            for found in HEX.findall(node.value):
                if len(found) == 7:
                    yield node.lineno, f"colour: {found}"
        for name, value in _looks(node):
            if name in PAINTED and _is_colour(value):
                yield value.lineno, f"colour: {name}={ast.unparse(value)}"
            if name == "cmap" and isinstance(value, ast.Constant) and value.value not in MAPS:
                yield value.lineno, f"colour map: {value.value}"
            points = value.value if isinstance(value, ast.Constant) else None
            sized = name in ("fontsize", "labelsize")
            if sized and isinstance(points, int | float) and points < LEAST:
                yield value.lineno, f"letters of {points} points"


def _looks(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield names and values of a call's words and of a mapping's."""
    if isinstance(node, ast.Call):
        yield from ((word.arg, word.value) for word in node.keywords if word.arg)
    if isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                yield key.value, value


def _is_colour(value: ast.expr) -> bool:
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        return value.value not in PLAIN
    parts = value.elts if isinstance(value, ast.Tuple) and len(value.elts) in (3, 4) else []
    return bool(parts) and all(isinstance(each, ast.Constant) for each in parts)


def draws(source: str) -> bool:
    return bool(re.search(r"\bmatplotlib\b|\bImageDraw\b|\bplotting\b|<svg|gradio", source))


def palette() -> set[str]:
    return {
        each.lower() for each in HEX.findall(Path(plotting.__file__).read_text(encoding="utf-8"))
    }


def test_no_module_that_draws_has_a_look_of_its_own():
    found = {
        name: looks
        for name, path in modules().items()
        if name not in {STYLE, *EXCEPTIONS}
        and draws(source := path.read_text())
        and (looks := list(own_looks(source)))
    }
    assert not found, "take colours and letters from racines_data.plotting"


def test_the_exceptions_still_draw_and_their_own_colours_are_few():
    for name in EXCEPTIONS:
        source = modules()[name].read_text()
        assert draws(source)
        assert not [kind for _, kind in own_looks(source) if not kind.startswith("colour:")]
    shared = palette() | {each.lower() for each in HEX.findall(PAGES.read_text())}
    theme = modules()["racines_leaderboard.studio.app"].read_text()
    assert {each.lower() for each in HEX.findall(theme)} <= shared


@pytest.mark.parametrize(
    "source",
    [
        "RED = '#aa0000'",
        "axes.plot(x, y, color='red')",
        "axes.plot(x, y, color='0.5')",
        "draw.line(way, fill=(255, 0, 0))",
        "look = {'facecolor': 'tan'}",
        "axes.imshow(x, cmap='jet')",
        "font = ImageFont.load_default(12)",
        "from matplotlib import rcParams",
        "matplotlib.rcParams['font.size'] = 20",
        "import matplotlib.pyplot as plt",
        "axes.text(0, 0, 'small', fontsize=6)",
    ],
)
def test_it_sees_every_kind_of_look(source: str):
    assert list(own_looks(source))


@pytest.mark.parametrize(
    "source",
    [
        "axes.plot(x, y, color=OURS)",
        "axes.imshow(x, cmap='gray', vmin=0)",
        "draw.text(place, words, WORDS, letters(12), stroke_fill='black')",
        "'''Says #aabbcc in its text.'''",
        "issue = 'see #123'",
    ],
)
def test_it_lets_names_pass(source: str):
    assert not list(own_looks(source))


def test_pages_share_the_palette():
    """Of HTML and CSS: each colour is one of the pictures' or of the palette of pages."""
    shared = palette() | {each.lower() for each in HEX.findall(PAGES.read_text())}
    shared |= {"#000", "#fff"}
    pages = [
        path
        for folder in ("envs/racines_envs", "leaderboard/racines_leaderboard")
        for ending in ("css", "html")
        for path in (ROOT / folder).rglob(f"*.{ending}")
    ]
    assert len(pages) >= 3
    for path in pages:
        own = {each.lower() for each in HEX.findall(path.read_text())} - shared
        assert not own, f"{path.name}: {own}"
    night = PAGES.read_text().split("prefers-color-scheme: dark")[1]
    for each in (plotting.NIGHT, plotting.PANEL, plotting.LINE, plotting.PALE, plotting.WORDS):
        assert each in night


SEEN = {
    "all": np.eye(3),
    "no green": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no red": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no blue": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}  # fmt: skip
"""Linear RGB as people with dichromacy see it (Machado, Oliveira and Fernandes, 2009)."""
TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)  # fmt: skip


def linear(colour: str) -> np.ndarray:
    share = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = TO_XYZ @ rgb / TO_XYZ.sum(1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one: str, other: str) -> float:
    dark, light = sorted(float(TO_XYZ[1] @ linear(each)) for each in (one, other))
    return (light + 0.05) / (dark + 0.05)


TOGETHER = {
    "an episode": (plotting.PROBE, plotting.TRUTH, plotting.PATH, plotting.WARNING),
    "belief and truth": (plotting.BELIEF, plotting.TRUTH, plotting.WARNING),
    "views": tuple(plotting.view_colours(("a", "b", "c", "d", "e", "none")).values()),
    "series": tuple(plotting.colour(number) for number in range(8)),
    "two": (plotting.OURS, plotting.PAPER),
    "splits": tuple(plotting.SPLIT_COLOURS.values()),
    "axes": tuple(plotting.AXES.values()),
    "strengths": plotting.STRENGTH_COLOURS,
}


@pytest.mark.parametrize("eyes", SEEN)
@pytest.mark.parametrize("group", TOGETHER)
def test_what_stands_together_is_told_apart_by_all(group: str, eyes: str):
    seen = [lab((np.array(SEEN[eyes]) @ linear(each)).clip(0, 1)) for each in TOGETHER[group]]
    least = min(float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2))
    assert least > 12.0, f"{least:.1f}"


def test_words_are_read_on_their_ground():
    for sign in ("PROBE", "TRUTH", "PATH", "WARNING", "BELIEF", "PALE", "WORDS"):
        for ground in (plotting.NIGHT, plotting.PANEL):
            assert contrast(getattr(plotting, sign), ground) >= 4.5, sign
    assert contrast(plotting.INK, "#ffffff") > 7.0 and contrast(plotting.MUTED, "#ffffff") > 4.5


def test_letters_are_matplotlibs_own_in_pillow():
    assert letters(14).getname() == ("DejaVu Sans", "Book")
    assert letters(28).getlength("A4C") > 1.9 * letters(14).getlength("A4C")


def test_depth_is_marked_at_its_rows():
    image = Image.new("L", (200, 200))
    mark_depth(image, 0.8)  # 16 cm high
    marked = np.flatnonzero(np.asarray(image)[:, -1])
    assert len(marked) == 15 or len(marked) == 16
    assert marked[:3].tolist() == [12, 25, 38] or np.abs(marked[:3] - [12.5, 25, 37.5]).max() <= 1


@pytest.mark.parametrize("corner", [None, (1.0, 2.0)])
def test_a_chart_shows_depth_in_the_image(corner: tuple[float, float] | None):
    with card_style():
        figure = Figure((3.0, 3.0))
        axis = figure.subplots()
        axis.imshow(np.zeros((128, 128)), cmap="gray", vmin=0, vmax=255)
        axis.set(xlim=(-0.5, 127.5), ylim=(127.5, -0.5))
        show_depth(axis, 128 if corner is None else 60, 1.0, corner)
        assert encode(figure, gray=True)[:4] == b"\x89PNG"
    told = [text.get_text() for text in axis.texts]
    assert told == (["5", "10", "2 cm"] if corner is None else ["5", "2 cm"])
    assert {text.get_fontsize() for text in axis.texts} == {SMALL}
    x = np.concatenate([line.get_xdata() for line in axis.lines])
    left = -0.5 if corner is None else corner[0]
    assert left <= x.min() and x.max() <= left + (128 if corner is None else 60)
