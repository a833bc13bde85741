"""One chart a track: every figure of the table as a dot with its interval, a panel a figure."""

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.files import write_atomic
from racines_leaderboard.board.groups import rankings
from racines_leaderboard.board.rank import Ranked, Record, metric_of
from racines_leaderboard.records.tracks import Column, Track

INK = "#1f3a5f"
PANELS_A_ROW = 5


def write_chart(path: Path, track: Track, records: list[Record]) -> bool:
    """Draw the results of a track as a PNG file; return False where there is none to draw."""
    ranking = rankings(track, records)
    columns = [c for c in track.columns if any(metric_of(r.record, c.key) for r in ranking)]
    if not columns:
        return False
    down = -(-len(columns) // PANELS_A_ROW)
    across = -(-len(columns) // down)
    height = 0.9 + 0.32 * len(ranking)
    canvas = Figure(figsize=(1.6 + 2.5 * across, 0.5 + height * down), layout="constrained")
    axes = canvas.subplots(down, across, squeeze=False, sharey=True)
    for axis in axes.flat[len(columns) :]:
        axis.set_visible(False)
    for axis, column in zip(axes.flat, columns, strict=False):
        panel(axis, column, ranking)
    canvas.suptitle(f"{track.name.capitalize()}: best at the top; bars are 95 % intervals", size=10)
    image = io.BytesIO()
    canvas.savefig(image, format="png", dpi=130)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, image.getvalue())
    return True


def panel(axis: Axes, column: Column, ranking: Sequence[Ranked]) -> None:
    """Draw one figure of N results, a line each, as dots with their 95 % intervals."""
    for row, ranked in enumerate(ranking):
        metric = metric_of(ranked.record, column.key)
        if metric is None:
            continue
        value = metric["value"] * column.scale
        if metric["low"] is not None and metric["high"] is not None:
            ends = [metric["low"] * column.scale, metric["high"] * column.scale]
            axis.plot(ends, [row, row], color=INK, alpha=0.45, linewidth=3, solid_capstyle="butt")
        axis.plot([value], [row], "o", color=INK, markersize=5)
    axis.set_yticks(range(len(ranking)), [_label(r.record) for r in ranking], size=9)
    axis.set_ylim(len(ranking) - 0.4, -0.6)
    axis.set_title(column.title, size=9)
    axis.tick_params(axis="x", labelsize=8)
    axis.grid(axis="x", color="#dddddd", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)


def _label(record: Record) -> str:
    task = record["scores"].get("task")
    return f"{record['name']} ({task['view']})" if task else record["name"]
