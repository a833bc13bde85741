"""The picture that matters: one row a pose, one column a generator, the truth first."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore
from racines_models.pictures import pick_columns
from racines_models.sample import Sample, draw, evenly, take_sample
from racines_models.scores.turns import HALF

CELL = 1.28
"""Edge of an image on the page, inches: at 100 dots an inch a pixel is a pixel."""
DPI = 100
TURNS = 6
"""Held-out turns that are shown where frames are of turns."""


def gallery_sample(store: FrameStore, split: str = "test", samples: int = 256) -> Sample:
    """Return up to 8 held-out frames: the best of each view, then others at even distances.

    Of turns about the apex: 6, evenly spread over those held out in order of their angles, modulo
    half a turn, each at the next phase.
    """
    sample = take_sample(store, split, samples)
    frames = sample.frames
    if store.turns is None:
        rows = pick_columns(frames.views, frames.grades, len(store.labels) - 1)
    else:
        rows = _pick_turns(store, frames.index)
    return Sample(type(frames)(*(column[rows] for column in frames)), sample.trajectory[rows])


def _pick_turns(store: FrameStore, index: Tensor) -> Tensor:
    """Return which of (N,) rows of a store to show."""
    assert store.turns is not None
    at = torch.remainder(store.turns[index, 0], HALF)
    order = torch.unique(at)
    picked = []
    for k, place in enumerate(evenly(len(order), TURNS).tolist()):
        own = (at == order[place]).nonzero().squeeze(1)
        picked.append(own[k % len(own)])
    return torch.stack(picked)


def write_gallery(
    path: Path, store: FrameStore, sample: Sample, generators: Mapping[str, ImageSource], seed: int
) -> None:
    """Draw each pose of a sample with each generator, by the name of its column; write the PNG.

    The store names the labels, the seed draws the generators' noise.
    """
    if not generators:
        raise RacinesError("gallery: name one generator or more")
    frames = sample.frames
    columns = {"truth": frames.images}
    columns |= {name: draw(each, frames, seed) for name, each in generators.items()}
    labels = []
    for view, grade in zip(frames.views.tolist(), frames.grades.tolist(), strict=True):
        name = store.labels[view] if view >= 0 else ""
        labels.append(f"{name}\n{grade:.1f}" if name and math.isfinite(grade) else name)
    if store.turns is not None:
        labels = [f"{at:.0f}°\n{away:.0f}° off" for at, away in store.turns[frames.index].tolist()]
    write_atomic(path, _page(columns, labels))


def _page(columns: Mapping[str, Tensor], labels: Sequence[str]) -> bytes:
    from racines_data.plotting import card_style, encode

    with card_style():
        return encode(_drawn(columns, labels), gray=True)


def _drawn(columns: Mapping[str, Tensor], labels: Sequence[str]) -> Any:
    """Return the figure of the columns, a line a pose."""
    from matplotlib.figure import Figure

    down, across = len(labels), len(columns)
    left, top = 0.6, 0.35
    width, height = left + across * CELL, top + down * CELL
    page = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    for j, (name, images) in enumerate(columns.items()):
        for i, image in enumerate(images):
            x, y, edge = left + j * CELL, height - top - (i + 1) * CELL, CELL - 0.02
            axis = page.add_axes((x / width, y / height, edge / width, edge / height))
            axis.imshow(image.numpy(), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axis.axis("off")
        page.text((left + (j + 0.5) * CELL) / width, 1 - 0.2 / height, name, ha="center", size=9)
    for i, label in enumerate(labels):
        middle = (height - top - (i + 0.5) * CELL) / height
        page.text(0.3 / width, middle, label, ha="center", va="center", size=9)
    return page
