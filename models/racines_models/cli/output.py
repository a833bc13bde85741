"""The tables that the scoring commands print."""

from typing import Any

from rich.console import Console

from racines_data.tables import console_table


def show_metrics(title: str, metrics: dict[str, Any]) -> None:
    """Print metrics with their intervals."""
    rows = []
    for name, metric in metrics.items():
        unit = f" {metric['unit']}" if metric.get("unit") else ""
        interval = "-"
        if metric["low"] is not None:
            interval = f"{metric['low']:.4g} to {metric['high']:.4g}"
        rows.append((name, f"{metric['value']:.4g}{unit}", interval, str(metric["n"])))
    Console().print(console_table(("figure", "value", "95 % interval", "n"), rows, title))


def show_realism(content: dict[str, Any]) -> None:
    """Print each realism figure of the phantom beside that of two halves of the real frames."""
    title = f"{content['config']}, {content['view']}, {content['n']} frames a set"
    title += f", {content['splits']} splits"
    rows = []
    for name, figure in content["figures"].items():
        ours, real = figure["phantom"], figure["real"]
        ratio = f"{ours['value'] / real['value']:.3g}" if real["low"] > 0 else "-"
        rows.append((name, _ranged(ours), _ranged(real), ratio))
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
        rows.append((row["name"], _ranged({"value": row["kid"], **row}), change))
    head = ("variant", "KID (range over splits)", "change (range over the same splits)")
    Console().print(console_table(head, rows, title))


def _ranged(figure: dict[str, float]) -> str:
    return f"{figure['value']:.4g} ({figure['low']:.4g} to {figure['high']:.4g})"
