"""What the commands print: JSON where it is asked for, else lines and tables."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from racines_data.tables import console_table
from racines_data.terminal import console, note, say, say_json

if TYPE_CHECKING:
    from racines_data.errors import RacinesError
    from racines_models.protocol import Run
    from racines_models.training.sets import Training


def tell(content: dict[str, Any], as_json: bool, *shown: str | Table) -> None:
    """Print what a command found: as JSON, or else the lines and tables that show it."""
    if as_json:
        say_json(content)
        return
    for each in shown:
        if isinstance(each, str):
            say(each)
        else:
            console().print(each)


def told_of(
    trainings: Sequence["Training"],
) -> "Callable[[Run, dict[str, Any] | RacinesError], None]":
    """Return what notes of each run of a set that it ended, and how many there are."""
    count, total = 0, sum(each.repeats for each in trainings)

    def told(run: "Run", metrics: "dict[str, Any] | RacinesError") -> None:
        nonlocal count
        count += 1
        ended = "done" if isinstance(metrics, dict) else "refused"
        note(f"racines: {run.folder}: seed {run.seed} {ended} ({count} of {total})")

    return told


def tell_trained(
    trainings: Sequence["Training"], metrics: Sequence[dict[str, Any]], as_json: bool,
    words: Callable[[dict[str, Any]], str],
) -> None:  # fmt: skip
    """Print what trainings ended with: of one its metrics, of several each by its folder."""
    pairs = [(str(each.run.folder), own) for each, own in zip(trainings, metrics, strict=True)]
    content = {"out": pairs[0][0], **pairs[0][1]} if len(pairs) == 1 else {"trained": dict(pairs)}
    tell(content, as_json, *(f"{folder}: {words(own)}" for folder, own in pairs))


def ranged(metric: dict[str, Any]) -> str:
    """Return a value with its range, where it has one."""
    if metric["low"] is None:
        return f"{metric['value']:.4g}"
    return f"{metric['value']:.4g} ({metric['low']:.4g} to {metric['high']:.4g})"


def metrics_table(title: str, metrics: dict[str, Any]) -> Table:
    """Return the table of metrics with their intervals."""
    rows = []
    for name, metric in metrics.items():
        unit = f" {metric['unit']}" if metric.get("unit") else ""
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}{unit}"
        low, high = metric["low"], metric["high"]
        interval = "-" if low is None else f"{low:.4g} to {high:.4g}"
        rows.append((name, value, interval, str(metric.get("n", ""))))
    return console_table(("figure", "value", "95 % interval", "n"), rows, title)


def show_metrics(title: str, metrics: dict[str, Any]) -> None:
    """Print metrics with their intervals."""
    console().print(metrics_table(title, metrics))


def show_training(title: str, out: Path, metrics: dict[str, Any], as_json: bool) -> None:
    """Print what a training of a judge left: its metrics, by view too, and its speed."""
    views = {f"view_accuracy, {name}": each for name, each in metrics.get("views", {}).items()}
    table = metrics_table(f"{title}, {metrics['split']} split", metrics["metrics"] | views)
    speed = f"{out}: {metrics['training']['images_per_second']} images/s in training"
    tell({"out": str(out)} | metrics, as_json, table, speed)


def judge_figures(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return what is shown of a grader's report: views, grades and calibration."""
    views = {f"view_accuracy, {name}": each for name, each in metrics["views"].items()}
    shown = metrics["metrics"] | views
    for name, figures in metrics["grades"].items():
        shown |= {f"grade_{kind}, {name}": figure for kind, figure in figures.items()}
    for when in ("before", "after"):
        if when in metrics["calibration"]:
            shown[f"calibration_error, {when}"] = metrics["calibration"][when]
    return shown
