"""The pictures of the report: what is called A4C, ejection fractions, and frames with outlines."""

from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from torch import Tensor

from racines_data.plotting import (
    GREEN,
    INK,
    MUTED,
    NO_VIEW,
    OURS,
    PAPER,
    SMALL,
    TISSUES,
    card_style,
    encode,
)
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.sample import evenly
from racines_models.studies.realism.patients import LISTS, UNLISTED, list_of
from racines_models.studies.sim_to_real.controls import CONTROLS
from racines_models.studies.sim_to_real.frames import RealEcho
from racines_models.studies.sim_to_real.report import Measured

COLOURS = {"tuning": NO_VIEW, "reporting": OURS, "unlisted": GREEN}
OUTLINES = {1: TISSUES["LV"], 2: TISSUES["LV myocardium"], 3: TISSUES["LA"]}
COLUMNS = 8


def draw(
    real: RealEcho, measured: Measured, segmentation: SegmentationJudge | None = None
) -> dict[str, bytes]:
    """Return PNG files by the ending of their names: empty for the contact sheet.

    The judge outlines what no cardiologist did: other views, and planes turned away.
    """
    content, drawn = measured.content, {}
    with card_style():
        # Of few colours the grays would take most, and outlines turn into each other.
        drawn[""] = encode(contact_sheet(real, measured, segmentation), few=False)
        if "acceptance" in content:
            drawn["-acceptance"] = encode(acceptance_figure(real, measured))
        if "volumes" in content:
            drawn["-ejection"] = encode(ejection_figure(content["volumes"]))
    return drawn


def acceptance_figure(real: RealEcho, measured: Measured) -> Figure:
    """Draw the shares called A4C, and acceptance against the turn where there is a rotation."""
    turned = real.rotation is not None
    figure = Figure(figsize=(9.6 if turned else 4.6, 3.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, 2 if turned else 1))
    _shares(panels[0], measured.content["acceptance"])
    if turned:
        _turns(panels[1], real, measured)
    return figure


def _shares(axes: Axes, acceptance: dict[str, Any]) -> None:
    width = 0.8 / len(acceptance)
    for number, (name, controls) in enumerate(acceptance.items()):
        figures = [controls[control]["called_a4c"] for control in CONTROLS]
        value, low, high = (
            np.array([f[key] for f in figures], float) for key in ("value", "low", "high")
        )
        at = np.arange(len(figures)) + (number - (len(acceptance) - 1) / 2) * width
        n = figures[0]["settings"]["units"]
        axes.bar(at, value, width, color=COLOURS[name], label=f"{name}, {n} patients")
        ends = np.abs(np.nan_to_num([value - low, high - value]))
        axes.errorbar(at, value, ends, fmt="none", ecolor=INK, linewidth=0.8)
    axes.set_xticks(range(len(CONTROLS)), list(CONTROLS))
    axes.set(ylim=(0, 1), ylabel="share called A4C", title="real A4C frames, shown in four ways")
    axes.legend()


def _turns(axes: Axes, real: RealEcho, measured: Measured) -> None:
    called, bins = measured.answers.turns, measured.content["rotation"]["bins"]
    assert real.rotation is not None and called is not None
    each = f"a frame, n = {len(called.probability)}"
    axes.scatter(real.rotation.angle, called.probability, 3, MUTED, linewidths=0, label=each)
    seen = [each for each in bins if each["frames"]]
    middle = [(each["from"] + each["to"]) / 2 for each in seen]
    share = [each["called_a4c"] for each in seen]
    axes.plot(middle, share, "o-", color=PAPER, markersize=3.5, label="share called A4C, by turn")
    axes.set_xticks(range(-180, 181, 60))
    axes.set(ylim=(-0.02, 1.02), ylabel="probability of A4C", xlabel="turn from A4C, degrees")
    axes.set_title(f"one heart, {measured.content['rotation']['turns']} turns about the apex")
    axes.legend()


def ejection_figure(volumes: dict[str, Any]) -> Figure:
    """Draw the judge's ejection fractions against the cardiologists', twice: Bland and Altman."""
    figure = Figure(figsize=(8.4, 3.6 * len(volumes)), layout="constrained")
    rows = figure.subplots(len(volumes), 2, squeeze=False)
    for (left, right), (name, told) in zip(rows, volumes.items(), strict=True):
        fraction = told["ejection_fraction"]
        pairs = [each for each in fraction["pairs"].values() if None not in each]
        pairs = [each for each in pairs if 0.0 <= each[0] <= 100.0]
        found, truth = np.array(pairs, float).reshape(-1, 2).T
        left.plot([0, 100], [0, 100], ":", color=MUTED, linewidth=0.8)
        left.scatter(truth, found, 9, COLOURS[name])
        left.set(xlim=(0, 100), ylim=(0, 100), xlabel="cardiologists, %", ylabel="judge, %")
        left.set_title(f"ejection fraction, one plane: {name}")
        right.scatter((found + truth) / 2, found - truth, 9, COLOURS[name])
        for key in ("lower_limit", "bias", "upper_limit"):
            if key in fraction:
                style = "-" if key == "bias" else "--"
                line = fraction[key]
                right.axhline(line["value"], color=PAPER, linewidth=0.9, linestyle=style)
                if line["low"] is not None:
                    right.axhspan(line["low"], line["high"], color=PAPER, alpha=0.12, linewidth=0)
        right.set(xlabel="mean of both, %", ylabel="judge less cardiologists, % points")
        right.set_title(
            "{patients} patients; {not_seen} not seen, {impossible} impossible".format(**fraction)
        )
    return figure


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
