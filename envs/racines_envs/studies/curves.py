"""Learning curves of agents, from what a training leaves: metrics.json and the tables beside it."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from racines_data.errors import RacinesError
from racines_data.plotting import INK, MUTED, card_style, colour
from racines_envs.evaluation.agent_specs import read_json, split_label
from racines_envs.evaluation.pictures import save
from racines_envs.studies.rewards import PAPER
from racines_envs.task.rewards import follows_paper
from racines_models.training.curves import CURVES

SCHEMA = "racines.agent-curves/1"
PANELS = {
    "validation/success": "true success of validations",
    "validation/steps": "mean episode of validations, steps",
    "validation/return": "mean return of validations",
    "train/return": "mean return while training",
}


def read_curves(specs: Sequence[str]) -> dict[str, Any]:
    """Read the curves of `[LABEL=]FOLDER`s; runs of one label are training seeds of one thing.

    A finished run's validations come from metrics.json; all else, and a run under way, from
    the tables under dvclive/. A run without validations by environment steps is refused.
    """
    if not specs:
        raise RacinesError("no run given: name run folders of trained agents")
    return {"schema": SCHEMA, "runs": [_read(*split_label(spec)) for spec in specs]}


def _read(label: str | None, folder: str) -> dict[str, Any]:
    where = Path(folder)
    if not where.is_dir():
        raise RacinesError(f"{where}: no such run folder")
    described = where / "config.json"
    content = read_json(described) if described.is_file() else {}
    metrics = where / "metrics.json"
    history = read_json(metrics).get("history", []) if metrics.is_file() else []
    curves = {}
    for name in PANELS:
        told = [[row["frames"], row[name]] for row in history if "frames" in row and name in row]
        table = _table(where, name)
        if told or table:
            curves[name] = told or table
    if not any(name.startswith("validation/") for name in curves):
        raise RacinesError(
            f"{where}: no validations by environment steps, in metrics.json or dvclive/: run "
            "`racines train agent`"
        )
    config = content.get("config", {})
    settings = {key: config.get(key) for key in ("view", "observation", "reward", "backend")}
    named = {"label": label or where.resolve().name, "folder": folder, "seed": content.get("seed")}
    return {**named, **settings, "curves": curves}


def _table(folder: Path, name: str) -> list[list[float]]:
    """Read (step, value) rows; a step that a resumed run wrote again counts as it was last."""
    path = folder / CURVES / "plots" / "metrics" / f"{name}.tsv"
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        rows = list(csv.reader(file, delimiter="\t"))[1:]
    try:
        values = {float(row[0]): float(row[-1]) for row in rows if row}
    except ValueError as error:
        raise RacinesError(f"{path}: not a table of numbers: {error}") from error
    return [[step, value] for step, value in sorted(values.items())]


def joined(curves: Sequence[Sequence[Sequence[float]]]) -> tuple[np.ndarray, ...]:
    """Return (T,) steps and the mean, least and greatest of several curves at them.

    The steps are those at which any of them was looked at, as far as all of them go; between its
    own a curve is a straight line.
    """
    parts = [np.asarray(curve, np.float64) for curve in curves]
    low, high = max(part[0, 0] for part in parts), min(part[-1, 0] for part in parts)
    steps = np.unique(np.concatenate([part[:, 0] for part in parts]))
    steps = steps[(steps >= low) & (steps <= high)]
    values = np.stack([np.interp(steps, part[:, 0], part[:, 1]) for part in parts])
    return steps, values.mean(0), values.min(0), values.max(0)


@card_style()
def draw_curves(content: dict[str, Any], path: Path, paper: bool = True) -> None:
    """Draw one line a label: a run, or the mean of its training seeds and their range; PNG.

    `content` is what `read_curves` returned. With `paper` the paper's levels for SC are dashed:
    episode lengths, and returns where a run was paid by the paper's formula.
    """
    runs = content["runs"]
    panels = [name for name in PANELS if any(name in run["curves"] for run in runs)]
    figure = Figure(figsize=(4.1 * len(panels) + 0.4, 3.9), layout="constrained")
    grid = figure.subplots(1, len(panels), squeeze=False)
    for name, axes in zip(panels, grid[0], strict=True):
        for number, label in enumerate(dict.fromkeys(run["label"] for run in runs)):
            same = [run["curves"] for run in runs if run["label"] == label]
            curves = [each[name] for each in same if name in each]
            if curves:
                _draw_line(axes, curves, label, colour(number))
        if paper:
            _draw_paper(axes, name, runs)
        axes.set(xlabel="environment steps", title=PANELS[name])
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 50k
        if name == "validation/success":
            axes.set_ylim(-0.03, 1.03)
    shown = grid[0, 0].get_legend_handles_labels()
    figure.legend(*shown, loc="outside lower center", ncols=4)
    save(figure, path)


def _draw_line(axes: Any, curves: list[Any], label: str, colour: str) -> None:
    steps, mean, low, high = joined(curves)
    name = label if len(curves) == 1 else f"{label}, {len(curves)} seeds: mean, range"
    axes.plot(steps, mean, marker="." if len(steps) < 40 else "", color=colour, label=name)
    if len(curves) > 1:
        axes.fill_between(steps, low, high, color=colour, alpha=0.18, linewidth=0)


def _draw_paper(axes: Any, panel: str, runs: list[dict[str, Any]]) -> None:
    """Draw the paper's levels of the observations shown, where they can be compared."""
    figure = panel.removeprefix("validation/")
    if figure not in PAPER:
        return
    levels: dict[float, list[str]] = {}
    fit = [run for run in runs if run["view"] == "SC"]
    if figure == "return":
        fit = [run for run in fit if follows_paper(run["reward"])]
    for seen in dict.fromkeys(run["observation"] for run in fit):
        levels.setdefault(PAPER[figure][seen], []).append(seen)
    for level, seen in levels.items():
        axes.axhline(level, linestyle="--", color=MUTED, linewidth=1.0)
        text = f"paper, {' and '.join(seen)}: about {level:g}"
        where = {"xycoords": ("axes fraction", "data"), "ha": "left", "va": "bottom"}
        behind = {"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.7, "linewidth": 0}
        axes.annotate(text, (0.01, level), fontsize=7.5, color=INK, bbox=behind, **where)
