"""The charts of the report: what is called A4C, whereto the probe is turned, ejection fractions.

No pixel is drawn of the frames of patients, whose licence may forbid it; of a rotation, a few are.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.plotting import GREEN, GRID, INK, MUTED, NO_VIEW, OURS, PAPER, SMALL
from racines_models.studies.sim_to_real.acceptance import SECTORS, Called
from racines_models.studies.sim_to_real.controls import CONTROLS
from racines_models.studies.sim_to_real.frames import VIEW, Rotation

COLOURS = {"tuning": NO_VIEW, "reporting": OURS, "unlisted": GREEN}
MARKS = {"tuning": "o", "reporting": "s", "unlisted": "^"}
SHOWN = 8
"""Frames of a rotation that are drawn under its chart."""


class Turned(NamedTuple):
    """What one grader says of a rotation."""

    called: Called
    told: dict[str, Any]
    """By `accepted_turns`."""

    @property
    def hits(self) -> np.ndarray:
        """(N,) bool, called A4C."""
        return self.called.label == list(self.told["called"]).index(VIEW)


def shares_figure(acceptance: dict[str, Any], rotation: Rotation | None = None) -> Figure:
    """Draw the shares called A4C; of a rotation, its frame nearest A4C above each."""
    figure = Figure(figsize=(6.4, 4.8 if rotation else 3.4), layout="constrained")
    bars = figure
    if rotation:
        above, bars = figure.subfigures(2, 1, squeeze=False, height_ratios=[1, 2])[:, 0]
        nearest = int(np.argmin(np.abs(rotation.angle)))
        image = rotation.images[nearest : nearest + 1]
        for axes, show in zip(above.subplots(1, len(CONTROLS)), CONTROLS.values(), strict=True):
            _show(axes, show(image)[0].numpy(), "")
        told = "an example: a frame of the turned heart, which is not among the bars' patients"
        above.suptitle(told, fontsize=SMALL)
    _bars(bars.subplots(), acceptance)
    return figure


def _bars(axes: Axes, acceptance: dict[str, Any]) -> None:
    width = 0.8 / len(acceptance)
    for number, (name, controls) in enumerate(acceptance.items()):
        figures = [controls[control]["called_a4c"] for control in CONTROLS]
        value, low, high = (
            np.array([f[key] for f in figures], float) for key in ("value", "low", "high")
        )
        at = np.arange(len(figures)) + (number - (len(acceptance) - 1) / 2) * width
        n, frames = figures[0]["settings"]["units"], figures[0]["n"]
        told = f"{name}: {n} patients, {frames} frames"
        axes.bar(at, value, width, color=COLOURS[name], label=told)
        ends = np.abs(np.nan_to_num([value - low, high - value]))
        axes.errorbar(at, value, ends, fmt="none", ecolor=INK, linewidth=0.8)
    axes.set_xticks(range(len(CONTROLS)), list(CONTROLS))
    axes.set(ylim=(0, 1), ylabel="share called A4C", title="real A4C frames, shown in four ways")
    axes.legend()


def turns_figure(rotation: Rotation, graders: Mapping[str, Turned]) -> Figure:
    """Draw acceptance against the turn of one heart, by up to three graders, and some frames."""
    figure = Figure(figsize=(9.6, 6.2), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[3.2, 1])[:, 0]
    top, counts = above.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    rows = _shown(rotation)
    for ink, (name, turned) in zip((OURS, PAPER, GREEN), graders.items(), strict=False):
        _accepted(top, rotation, turned, name, ink)
    _sectors(top)
    for letter, row in zip("abcdefgh", rows, strict=False):
        top.text(rotation.angle[row], -0.05, letter, ha="center", va="center", fontsize=SMALL)
    bins = next(iter(graders.values())).told["bins"]
    _counts(counts, bins)
    top.set(ylim=(-0.09, 1.12), yticks=np.arange(0, 1.1, 0.2), ylabel="share called A4C")
    frames, turns = len(rotation.angle), len(np.unique(rotation.turn))
    top.set_title(f"one patient: {turns} turns, {frames} frames; faint: single turns")
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=len(graders))
    for axes, letter, row in zip(below.subplots(1, SHOWN), "abcdefgh", rows, strict=False):
        said = " / ".join(f"{each.called.probability[row]:.2f}" for each in graders.values())
        _show(axes, rotation.images[row].numpy(), f"{letter}: {rotation.angle[row]:.0f}°, {said}")
    for axes in below.axes[len(rows) :]:
        axes.set_axis_off()
    below.suptitle("frames at the letters: turn, and probability of A4C", fontsize=SMALL)
    return figure


def _accepted(axes: Axes, rotation: Rotation, turned: Turned, name: str, ink: str) -> None:
    """Draw the shares of bins, not joined over turns that nobody recorded, and of single turns."""
    bins = turned.told["bins"]
    middle = [(each["from"] + each["to"]) / 2 for each in bins]
    share = [each.get("called_a4c", np.nan) for each in bins]
    _, first, turn = np.unique(rotation.turn, return_index=True, return_inverse=True)
    each = np.bincount(turn, turned.hits) / np.bincount(turn)
    axes.scatter(rotation.angle[first], each, 7, ink, alpha=0.3, linewidths=0)
    axes.plot(middle, share, "o-", color=ink, markersize=4.5, label=name)


def _sectors(axes: Axes) -> None:
    """Name what the turns show, either way from A4C."""
    for name, (low, high) in SECTORS.items():
        for start, end in {(low, high), (-high, -low)} if low else {(-high, high)}:
            axes.axvspan(start, end, color=GRID, alpha=0.6, linewidth=0, zorder=0)
            narrow, middle = end - start < 20.0, (start + end) / 2
            said = axes.text(middle, 1.09, name, ha="center", va="top", fontsize=SMALL)
            said.set_rotation(90.0 if narrow else 0.0)


def _counts(axes: Axes, bins: list[dict[str, Any]]) -> None:
    frames = [each["frames"] for each in bins]
    middle = [(each["from"] + each["to"]) / 2 for each in bins]
    axes.bar(middle, frames, bins[0]["to"] - bins[0]["from"] - 2, color=MUTED)
    for x, count in zip(middle, frames, strict=True):
        axes.text(x, count, f"{count}", ha="center", va="bottom", fontsize=SMALL)
    axes.set(ylim=(0, 1.5 * max(frames)), ylabel="frames", xlabel="turn from A4C, degrees")
    axes.set_xticks(range(-180, 181, 45))
    axes.set_xlim(-184, 184)


def _shown(rotation: Rotation) -> list[int]:
    """Return the frames of a rotation nearest to turns at even distances, by turn."""
    wanted = np.linspace(rotation.angle.min(), rotation.angle.max(), SHOWN)
    apart = np.abs(rotation.angle[None] - wanted[:, None])
    return list(dict.fromkeys(apart.argmin(1).tolist()))


def _show(axes: Axes, image: np.ndarray, title: str) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=SMALL, fontweight="normal")
    axes.set_axis_off()


def ejection_figure(volumes: dict[str, Any]) -> Figure:
    """Draw the judge's ejection fractions against the cardiologists', and Bland and Altman's way.

    Each list of patients has its own mark, and its own panel of differences.
    """
    figure = Figure(figsize=(4.0 * (1 + len(volumes)), 4.0), layout="constrained")
    first = figure.add_subplot(1, 1 + len(volumes), 1)
    first.plot([0, 100], [0, 100], color=MUTED, linewidth=0.9)
    for number, (name, told) in enumerate(volumes.items()):
        _fractions(first, name, told["ejection_fraction"], -4.0 * (number + 1))
    first.set(xlim=(0, 100), ylim=(-4.0 * len(volumes) - 4, 122))
    first.set(xlabel="cardiologists' outlines, %", ylabel="judge's outlines, %")
    first.set_yticks(range(0, 101, 20))
    first.set_title("ejection fraction from one plane\n", fontsize=8.5)
    first.legend(fontsize=SMALL, loc="upper left")
    beside = None
    for place, (name, told) in enumerate(volumes.items(), start=2):
        beside = figure.add_subplot(1, 1 + len(volumes), place, sharey=beside)
        _differences(beside, name, told["ejection_fraction"])
    return figure


def _pairs(fraction: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the judge's and the cardiologists' figures of the patients in whom both have one."""
    pairs = [each for each in fraction["pairs"].values() if None not in each]
    found, truth = np.array(pairs, float).reshape(-1, 2).T
    return found, truth


def _fractions(axes: Axes, name: str, fraction: dict[str, Any], under: float) -> None:
    """Draw a list's patients; those in whom the judge's figure is below 0 as ticks, `under` it."""
    look = {"color": COLOURS[name], "alpha": 0.8}
    found, truth = _pairs(fraction)
    possible = (found >= 0.0) & (found <= 100.0)
    n, left = int(possible.sum()), int((~possible).sum())
    told = f"{name}: {n} patients; ticks: {left} below 0"
    at = truth[possible], found[possible]
    axes.plot(*at, MARKS[name], markersize=4, linewidth=0, label=told, **look)
    axes.plot(truth[~possible], np.full(left, under), "|", markersize=6, **look)


def _differences(axes: Axes, name: str, fraction: dict[str, Any]) -> None:
    found, truth = _pairs(fraction)
    possible = (found >= 0.0) & (found <= 100.0)
    found, truth = found[possible], truth[possible]
    look = {"color": COLOURS[name], "markersize": 4, "alpha": 0.8}
    axes.plot((found + truth) / 2, found - truth, MARKS[name], **look)
    for key, style in (("upper_limit", "--"), ("bias", "-"), ("lower_limit", "--")):
        if key not in fraction:
            continue
        line = fraction[key]
        axes.axhline(line["value"], color=PAPER, linewidth=0.9, linestyle=style)
        if line["low"] is not None:
            axes.axhspan(line["low"], line["high"], color=PAPER, alpha=0.12, linewidth=0)
        told = f"{key.replace('_', ' ')} {line['value']:+.1f}"
        axes.text(99, line["value"], told, ha="right", va="bottom", fontsize=SMALL, color=PAPER)
    axes.set(xlim=(0, 100), xlabel="mean of both, %", ylabel="judge less cardiologists, points")
    unseen = "left out: {not_seen} not seen, {impossible} below 0"
    told = f"{name}: {fraction['patients']} patients\n{unseen.format(**fraction)}"
    axes.set_title(told, fontsize=8.5)
