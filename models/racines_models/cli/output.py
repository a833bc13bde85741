"""The tables that the scoring commands print."""

import json
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from racines_data.tables import console_table


def ranged(metric: dict[str, Any]) -> str:
    """Return a value with its range, where it has one."""
    if metric["low"] is None:
        return f"{metric['value']:.4g}"
    return f"{metric['value']:.4g} ({metric['low']:.4g} to {metric['high']:.4g})"


def show_metrics(title: str, metrics: dict[str, Any]) -> None:
    """Print metrics with their intervals."""
    rows = []
    for name, metric in metrics.items():
        unit = f" {metric['unit']}" if metric.get("unit") else ""
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}{unit}"
        interval = "-"
        if metric["low"] is not None:
            interval = f"{metric['low']:.4g} to {metric['high']:.4g}"
        rows.append((name, value, interval, str(metric.get("n", ""))))
    Console().print(console_table(("figure", "value", "95 % interval", "n"), rows, title))


def show_training(title: str, out: Path, metrics: dict[str, Any], as_json: bool) -> None:
    """Print what a training of a judge left: its metrics, by view too, and its speed."""
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    views = {f"view_accuracy, {name}": each for name, each in metrics.get("views", {}).items()}
    show_metrics(f"{title}, {metrics['split']} split", metrics["metrics"] | views)
    typer.echo(f"{out}: {metrics['training']['images_per_second']} images/s in training")


def judge_figures(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return what is shown of a grader's report: views, grades and calibration."""
    shown = metrics["metrics"] | {
        f"view_accuracy, {name}": figure for name, figure in metrics["views"].items()
    }
    for name, figures in metrics["grades"].items():
        shown |= {f"grade_{kind}, {name}": figure for kind, figure in figures.items()}
    calibration = metrics["calibration"]
    for when in ("before", "after"):
        if when in calibration:
            shown[f"calibration_error, {when}"] = calibration[when]
    return shown


def show_realism(content: dict[str, Any]) -> None:
    """Print each realism figure of the phantom beside that of two halves of the real frames."""
    title = f"{content['config']}, {content['view']}, {content['n']} frames a set"
    title += f", {content['splits']} splits"
    rows = []
    for name, figure in content["figures"].items():
        ours, real = figure["phantom"], figure["real"]
        ratio = f"{ours['value'] / real['value']:.3g}" if real["low"] > 0 else "-"
        rows.append((name, ranged(ours), ranged(real), ratio))
    head = ("figure", "phantom, real", "real, real", "ratio")
    Console().print(console_table(head, rows, title))


def show_ablation(content: dict[str, Any]) -> None:
    """Print the KID of the phantom without each of its parts."""
    title = f"{content['view']}, {content['n']} frames a set, {content['splits']} splits"
    rows = []
    for row in (content["base"], *content["ablation"]):
        change = ""
        if "change" in row:
            reach = f"({row['change_low']:+.4f} to {row['change_high']:+.4f})"
            change = f"{row['change']:+.4f} {reach}"
        rows.append((row["name"], ranged({"value": row["kid"], **row}), change))
    head = ("variant", "KID (range over splits)", "change (range over the same splits)")
    Console().print(console_table(head, rows, title))
