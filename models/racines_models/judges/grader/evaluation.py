"""What stands beside a grader's weights: its report as `metrics.json`, and its pictures."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_data.files import write_atomic, write_json
from racines_data.plotting import (
    INK,
    MUTED,
    OURS,
    PAPER,
    SHARES,
    SMALL,
    card_style,
    encode,
    view_colours,
)
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.model import CONFIG, Grader, read_config
from racines_models.judges.grader.report import Examination, calibrate, examine, reliability
from racines_models.provenance import code_version, dataset_card

METRICS = "metrics.json"
SCHEMA = "racines.grader-metrics/1"
GRADES = (0.0, 10.0)


def write_report(
    folder: Path, grader: Grader, store: FrameStore, split: str = "test", **more: Any
) -> dict[str, Any]:
    """Examine a grader on a split and write `metrics.json` and the plots into `folder`.

    Keys that `metrics.json` has already and that the report does not make, such as what the
    training took, are kept; `more` is added.
    """
    examined = examine(grader, store, split)
    path = folder / METRICS
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    metrics = before | {"schema": SCHEMA} | examined.content | more
    metrics["plots"] = write_plots(folder, examined)
    write_json(path, metrics)
    return metrics


def evaluate_grader(
    folder: Path, store: FrameStore, split: str, out: Path, recalibrate: bool, device: str
) -> dict[str, Any]:
    """Report a saved grader on a split into `out`; `recalibrate` fits its temperature first."""
    grader = Grader.load(folder, device)
    if not len(store.split_indices(split)):
        raise RacinesError(f"split {split}: no frames; choose another with --split")
    made = {"evaluated": {"dataset": dataset_card(store), "code": code_version()}}
    if recalibrate:
        frames = calibrate(grader, store)
        fitted = {"split": "validation", "frames": frames, "dataset": dataset_card(store)}
        described = read_config(folder) | {"temperature": grader.temperature, "calibrated": fitted}
        write_json(folder / CONFIG, described)
    return write_report(out, grader, store, split, sha256=grader.sha256, **made)


def write_plots(folder: Path, examined: Examination) -> list[str]:
    """Draw what views and grades a split has into `folder`; return the names of the files."""
    figures: dict[str, Figure] = {}
    with card_style():
        if bool((examined.frames.views >= 0).any()):
            figures["confusion"] = confusion_figure(examined)
            figures["reliability"] = reliability_figure(examined)
        if examined.content["grades"]:
            figures["grades"] = grades_figure(examined)
            figures["views"] = views_figure(examined)
        for name, figure in figures.items():
            write_atomic(folder / f"{name}.png", encode(figure))
    return [f"{name}.png" for name in figures]


def confusion_figure(examined: Examination) -> Figure:
    """Draw the counts and the shares of each true label's frames, one row a true label."""
    content, names = examined.content, examined.grader.labels
    counts = np.array(content["confusion"]["counts"])
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    figure = Figure(figsize=(1.6 + 0.75 * len(names), 1.4 + 0.62 * len(names)), layout="tight")
    axes = figure.subplots()
    axes.imshow(share**0.5, cmap=SHARES, vmin=0.0, vmax=1.1, aspect="auto")
    axes.grid(False)
    for row, column in np.ndindex(*counts.shape):
        if counts[row, column]:
            text = f"{100 * share[row, column]:.1f} %\n{counts[row, column]:,}"
            colour = "white" if share[row, column] > 0.4 else INK
            axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=7.5)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    accuracy = content["metrics"]["view_accuracy"]["value"]
    n = counts.sum()
    title = f"Views, {content['split']} split: {100 * accuracy:.2f} % right, n = {n:,}"
    axes.set(xlabel="label given", ylabel="true label", title=title)
    return figure


def reliability_figure(examined: Examination) -> Figure:
    """Draw accuracy against confidence, before and after the temperature, over a histogram."""
    grader, frames, reading, content = examined
    figure = Figure(figsize=(4.6, 4.8), layout="tight")
    upper, lower = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    upper.plot([0, 1], [0, 1], color=MUTED, linewidth=0.8, linestyle=":", label="perfect")
    fitted = grader.temperature
    for key, temperature, name, colour, marker in (
        ("before", 1.0, "before", PAPER, "s"),
        ("after", fitted, f"after, T = {fitted:.2f}", OURS, "o"),
    ):
        table = reliability((reading.logits / temperature).softmax(-1), frames.views)
        filled = table.frames > 0
        x, y = table.confidence[filled], table.accuracy[filled]
        label = f"{name}: ECE {100 * content['calibration'][key]['value']:.2f} %"
        upper.plot(x, y, color=colour, marker=marker, markersize=4, linewidth=1.2, label=label)
        lower.step(x, table.frames[filled], color=colour, where="mid", linewidth=1.2)
    n = int((frames.views >= 0).sum())
    title = f"Calibration, {content['split']} split, n = {n:,}"
    upper.set(ylabel="accuracy", ylim=(0.0, 1.02), title=title)
    upper.legend(loc="upper left")
    lower.set(yscale="log", ylabel="frames", xlabel="confidence, mean of a bin")
    return figure


def grades_figure(examined: Examination) -> Figure:
    """Draw the grade given against the true one, a panel a view; darker is more frames."""
    grader, frames, reading, content = examined
    names = [name for name in grader.labels if name in content["grades"]]
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(2.5 * columns + 0.4, 2.4 * rows + 0.5), layout="tight")
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for axes, name in zip(panels, names, strict=False):
        chosen = (frames.views == grader.labels.index(name)) & frames.grades.isfinite()
        pair = frames.grades[chosen].numpy(), reading.grades[chosen].numpy()
        axes.hist2d(*pair, 40, (GRADES, GRADES), cmap=SHARES, norm=LogNorm(vmin=0.3), cmin=1)
        axes.plot(GRADES, GRADES, color=MUTED, linewidth=0.8, linestyle=":")
        mae, bias = (content["grades"][name][key]["value"] for key in ("mae", "bias"))
        told = f"{name}, n = {len(pair[0]):,}\nMAE {mae:.2f}, bias {bias:+.2f}"
        axes.set_title(told, size=8.5)
        axes.set_aspect("equal")
    for axes in panels[max(len(names) - columns, 0) : len(names)]:
        axes.tick_params(labelbottom=True)  # the lowest of each column
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel("true grade", fontsize=8.5, color=INK)
    figure.supylabel("grade given", fontsize=8.5, color=INK)
    return figure


def views_figure(examined: Examination) -> Figure:
    """Draw, by view, accuracy, mean absolute error and bias of the grade, with 95 % intervals."""
    content, labels = examined.content, examined.grader.labels
    figure = Figure(figsize=(8.4, 0.3 * len(labels) + 1.3), layout="tight")
    panels = figure.subplots(1, 3)
    shown = {"view accuracy": content["views"]}
    for key, title in (("mae", "grade, mean absolute error"), ("bias", "grade, bias")):
        shown[title] = {name: each[key] for name, each in content["grades"].items()}
    for axes, (title, figures) in zip(panels, shown.items(), strict=True):
        _intervals(axes, figures, view_colours(labels), title)
    panels[1].set_xlim(left=0.0)
    panels[2].axvline(0.0, color=MUTED, linewidth=0.8)
    panels[0].set_xlabel("share right")
    for axes in panels[1:]:
        axes.set_xlabel("grades, 0 to 10")
    return figure


def _intervals(axes: Axes, figures: dict[str, Any], colours: dict[str, str], title: str) -> None:
    for row, (name, figure) in enumerate(figures.items()):
        value, low, high = (figure[key] for key in ("value", "low", "high"))
        if low is not None:
            axes.plot([low, high], [row, row], color=colours[name], linewidth=2.2)
        axes.plot(value, row, "o", color=colours[name], markersize=5)
        above = {"xytext": (0, 5), "textcoords": "offset points", "ha": "center", "fontsize": SMALL}
        axes.annotate(f"{value:.3f}", (value, row), **above)
    axes.set_yticks(range(len(figures)), list(figures))
    axes.set(ylim=(len(figures) - 0.5, -0.7), title=title)
