"""The contact sheet of simulated patients: each in every view, and what a mask says of one frame.

patient 10002       A4C    SC    PL    PSAV    PSMV   |  the A4C with its mask over it
validation, dilated
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from racines_data.card import pictures
from racines_data.card.frames import Frames, read_frames
from racines_data.manifest import PICTURES, added_configs, measures_name, store_name
from racines_data.plotting import MUTED, TISSUES, card_style, evenly

PATIENTS = 6
"""Rows, at most."""
STRENGTH = 0.45
_EDGE, _STEP, _MARGIN, _HEAD, _FOOT, _GAP = 1.3, 1.34, 1.3, 0.22, 0.5, 0.16
"""Inches: edge of a frame, from one to the next, column of the names, line above, lines below, and
between the views and the mask."""


def write_sheets(final: Path, manifest: dict[str, Any]) -> None:
    """Draw the sheet of each added config whose store is written into `card/` of a dataset.

    Sets `sheet` of the config's part of the manifest: the picture's file.
    """
    for name in added_configs(manifest):
        write_sheet(final, name, manifest[name])


def write_sheet(final: Path, name: str, record: dict[str, Any]) -> None:
    """Draw the sheet of one added config; `record` is its part of the manifest."""
    path = final / f"{PICTURES}{name}.png"
    with card_style():
        png = pictures.draw(name, lambda: _read_figure(final, name, record))
    assert png is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)  # it may be a link to another dataset's
    path.write_bytes(png)
    record["sheet"] = f"{PICTURES}{name}.png"


def _read_figure(final: Path, name: str, record: Mapping[str, Any]) -> Figure:
    frames = read_frames(final / store_name(name), record)
    people = pq.read_table(final / measures_name(name), columns=["patient", "pathology", "split"])
    return sheet_figure(frames, people.to_pylist(), record["mask_labels"])


def sheet_figure(
    frames: Frames, people: list[dict[str, Any]], mask_labels: list[str] | tuple[str, ...]
) -> Figure:
    """Draw up to `PATIENTS` patients, a row each, in each view: the frame of the best grade.

    Args:
        frames: Of one config of patients.
        people: Of each patient `patient`, `pathology` and `split`, in the dataset's order.
        mask_labels: Names of the masks' labels by number; empty where there are no masks.
    """
    views, people = frames.labels[:-1], [people[i] for i in evenly(len(people), PATIENTS)]
    masked = frames.masks is not None
    aside = _MARGIN + len(views) * _STEP + _GAP
    width, height = aside + masked * _STEP, _HEAD + len(people) * _STEP + masked * _FOOT
    figure, axis = pictures.sheet(width, height)
    head: dict[str, Any] = {"size": 10, "weight": "bold", "ha": "center", "va": "bottom"}
    for column, view in enumerate(views):
        axis.text(_MARGIN + column * _STEP + _EDGE / 2, _HEAD - 0.05, view, **head)
    if masked:
        axis.text(aside + _EDGE / 2, _HEAD - 0.05, f"{views[0]}, mask", **head)
    owner = np.array(frames.patients)[frames.trajectory]
    for number, person in enumerate(people):
        top, own = _HEAD + number * _STEP, np.flatnonzero(owner == person["patient"])
        name: dict[str, Any] = {"ha": "right", "va": "top"}
        axis.text(
            _MARGIN - 0.08, top + 0.08, f"{person['patient']}", size=10, weight="bold", **name
        )
        told = f"{person['split']}\n{person['pathology']}"
        axis.text(_MARGIN - 0.08, top + 0.28, told, size=7.5, color=MUTED, **name)
        best = [_best(frames, own, label) for label in range(len(views))]
        for column, row in enumerate(best):
            left = _MARGIN + column * _STEP
            if row is None:
                look = {"size": 7.5, "color": MUTED, "ha": "center", "va": "center"}
                axis.text(left + _EDGE / 2, top + _EDGE / 2, "not shown in\nany frame", **look)
            else:
                pictures.place(axis, frames.images[row], left, top, _EDGE)
        if frames.masks is not None and best[0] is not None:
            image, mask = frames.images[best[0]], frames.masks[best[0]]
            pictures.place(axis, coloured(image, mask, mask_labels), aside, top, _EDGE)
    if masked:
        _legend(axis, mask_labels, width, height - _FOOT + 0.06)
    return figure


def coloured(
    image: np.ndarray, mask: np.ndarray, labels: list[str] | tuple[str, ...]
) -> np.ndarray:
    """Return (H, W, 3) uint8: a gray frame, (H, W) uint8, with the colours of its mask's labels."""
    table, strength = np.zeros((len(labels), 3)), np.zeros((len(labels), 1))
    for number, label in enumerate(labels):
        if label in TISSUES:
            table[number], strength[number] = to_rgb(TISSUES[label]), STRENGTH
    share = strength[mask]
    return (image[..., None] * (1.0 - share) + 255.0 * table[mask] * share).round().astype(np.uint8)


def _best(frames: Frames, rows: np.ndarray, label: int) -> int | None:
    """Return the row of the best grade of a view among some; None where none shows it."""
    shown = rows[(frames.views[rows] == label) & np.isfinite(frames.grades[rows])]
    return int(shown[frames.grades[shown].argmax()]) if len(shown) else None


def _legend(axis: Any, labels: list[str] | tuple[str, ...], width: float, top: float) -> None:
    """Name the colours below the frames, in lines of equal steps."""
    named = [label for label in labels if label in TISSUES]
    across = -(-len(named) // 2)
    for number, label in enumerate(named):
        left = _MARGIN + (width - _MARGIN) / across * (number % across)
        middle = top + 0.2 * (number // across) + 0.06
        look = {"s": 42, "marker": "s", "color": TISSUES[label], "edgecolor": MUTED, "lw": 0.5}
        axis.scatter([left + 0.06], [middle], **look)
        axis.text(left + 0.16, middle, label, size=7.5, va="center")
