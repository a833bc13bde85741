"""The pictures of the report: its charts, and a sheet of frames with what judges say of them."""

from typing import NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from torch import Tensor

from racines_data.plotting import SMALL, TISSUES, card_style, encode
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.sample import evenly
from racines_models.studies.realism.patients import LISTS, UNLISTED, list_of
from racines_models.studies.sim_to_real.charts import (
    Turned,
    ejection_figure,
    shares_figure,
    turns_figure,
)
from racines_models.studies.sim_to_real.frames import RealEcho
from racines_models.studies.sim_to_real.report import Measured

OUTLINES = {1: TISSUES["LV"], 2: TISSUES["LV myocardium"], 3: TISSUES["LA"]}
COLUMNS = 8


def draw(
    real: RealEcho, measured: Measured, segmentation: SegmentationJudge | None = None
) -> dict[str, bytes]:
    """Return PNG files by the ending of their names: empty for the contact sheet.

    The judge outlines what no cardiologist did: other views, and planes turned away.
    """
    content, drawn, rotation = measured.content, {}, real.rotation
    with card_style():
        # Of few colours the grays would take most, and outlines turn into each other.
        drawn[""] = encode(contact_sheet(real, measured, segmentation), few=False)
        if "acceptance" in content:
            shares = shares_figure(content["acceptance"], rotation)
            drawn["-acceptance"] = encode(shares, few=rotation is None)
        if rotation is not None and measured.answers.turns is not None:
            turned = Turned(measured.answers.turns, content["rotation"])
            drawn["-turns"] = encode(turns_figure(rotation, {"the grader": turned}), few=False)
        if "volumes" in content:
            drawn["-ejection"] = encode(ejection_figure(content["volumes"]))
    return drawn


class Tile(NamedTuple):
    """A frame of the contact sheet; masks are in CAMUS's numbers."""

    image: Tensor
    title: str
    ours: Tensor | None = None
    theirs: Tensor | None = None


def contact_sheet(
    real: RealEcho, measured: Measured, segmentation: SegmentationJudge | None
) -> Figure:
    """Draw frames with what they are called; cardiologists' outlines dashed, the judge's whole."""
    rows = [_frames_of(name, real, measured) for name in (*LISTS, UNLISTED)]
    rows += [
        _others(tiles, segmentation)
        for tiles in (_pictures(real, measured), _turns_of(real, measured))
    ]
    rows = [row for row in rows if row]
    figure = Figure(figsize=(1.55 * COLUMNS, 1.75 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), COLUMNS, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for line, row in zip(grid, rows, strict=True):
        for axes, tile in zip(line, row, strict=False):
            axes.imshow(tile.image.numpy(), cmap="gray", vmin=0, vmax=255)
            axes.set_title(tile.title, fontsize=SMALL, fontweight="normal")
            _outline(axes, tile.theirs, "dashed")
            _outline(axes, tile.ours, "solid")
    names = zip(("LV", "LV myocardium", "LA"), OUTLINES.values(), strict=True)
    handles = [Line2D([], [], color=colour, label=name) for name, colour in names]
    told = "outlines: whole the judge's, dashed the cardiologists'; figure: probability of A4C"
    figure.legend(handles=handles, loc="outside lower center", ncols=3, title=told)
    return figure


def _outline(axes: Axes, mask: Tensor | None, style: str) -> None:
    for number, colour in OUTLINES.items() if mask is not None else ():
        part = (mask == number).numpy()
        if part.any():
            axes.contour(part, [0.5], colors=colour, linewidths=0.8, linestyles=style)


def _frames_of(name: str, real: RealEcho, measured: Measured) -> list[Tile]:
    frames, drawn, answers = real.frames, real.drawn, measured.answers
    rows = np.flatnonzero([list_of(each) == name for each in frames.patient])
    place = {} if drawn is None else {int(row): at for at, row in enumerate(drawn.row)}
    tiles = []
    for row in rows[evenly(len(rows), COLUMNS)].tolist() if len(rows) else []:
        title = f"{name} {frames.patient[row][-4:]} {frames.phase[row]}"
        if answers.controls:
            title += f": {answers.controls['as they are'].probability[row]:.2f}"
        at = place.get(row)
        ours = None if at is None or answers.masks is None else answers.masks[at]
        theirs = None if at is None or drawn is None else drawn.masks[at]
        tiles.append(Tile(frames.images[row], title, ours, theirs))
    return tiles


def _others(tiles: list[Tile], segmentation: SegmentationJudge | None) -> list[Tile]:
    if segmentation is None or not tiles:
        return tiles
    masks = segmentation.segment_camus(torch.stack([tile.image for tile in tiles]))
    return [tile._replace(ours=mask) for tile, mask in zip(tiles, masks, strict=True)]


def _pictures(real: RealEcho, measured: Measured) -> list[Tile]:
    pictures, called = real.pictures, measured.answers.pictures
    if pictures is None:
        return []
    told = [f": {p:.2f}" for p in called.probability] if called else [""] * len(pictures.views)
    rows = zip(pictures.images, pictures.views, told, strict=True)
    return [Tile(image, view + p) for image, view, p in rows][:COLUMNS]


def _turns_of(real: RealEcho, measured: Measured) -> list[Tile]:
    called, rotation = measured.answers.turns, real.rotation
    if rotation is None:
        return []
    order = np.argsort(rotation.angle)
    rows = order[evenly(len(order), COLUMNS)].tolist()
    told = [f": {called.probability[row]:.2f}" if called else "" for row in rows]
    return [
        Tile(rotation.images[row], f"turned {rotation.angle[row]:.0f}°{p}")
        for row, p in zip(rows, told, strict=True)
    ]
