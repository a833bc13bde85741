"""Pictures of what agents did."""

import io
from pathlib import Path
from typing import Any

import numpy as np

SHOWN_DEPTH = 25.0
"""How much of the block is outlined below its top, mm."""


def draw_trajectories(evaluation: Any, path: Path) -> None:
    """Draw the probe's path from several starts, in 3-D, as PNG; mm in the robot base frame.

    The colour is the confidence p by the reward's own source; steps, p and, where one decision was
    timed, the time are written at the end of each path. The block's top is outlined.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    episodes, core, scores = evaluation.episodes, evaluation.core, evaluation.scores
    count = min(evaluation.pictured, len(episodes.final["steps"]))
    figure = plt.figure(figsize=(8.6, 6.6))
    axes: Any = figure.add_axes((0.0, 0.03, 0.82, 0.9), projection="3d")
    _draw_block(axes, core)
    for row in range(count):
        _draw_path(axes, *_path(episodes, row), row)
    target = core.target.position[0].cpu().numpy() * 1e3
    axes.scatter(*target, marker="*", s=150, color="black", zorder=5, label="nominal pose")
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
    axes.set_box_aspect((1.2, 1.0, 0.7))  # the height, in which the probe moves least, is stretched
    axes.view_init(elev=28.0, azim=-60.0)
    milliseconds = scores["metrics"].get("latency", {}).get("value")
    lines = [_line(episodes, row, milliseconds) for row in range(count)]
    figure.text(0.03, 0.03, "\n".join(lines), fontsize=8.5, va="bottom", family="monospace")
    figure.text(0.03, 0.95, _title(evaluation, count), fontsize=11)
    source = "grader" if core.reward_name == "paper" else "oracle"
    scale = plt.cm.ScalarMappable(plt.Normalize(0.0, 1.0), "viridis")
    bar = figure.add_axes((0.87, 0.25, 0.02, 0.5))
    figure.colorbar(scale, cax=bar, label=f"p of {core.task.view}, by the {source}")
    axes.legend(loc="upper right", fontsize=8)
    save(figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG, aside first, and close it."""
    from matplotlib import pyplot as plt

    from racines_data.files import write_atomic

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    plt.close(figure)
    write_atomic(path, buffer.getvalue())


def _title(evaluation: Any, count: int) -> str:
    task = evaluation.scores["task"]
    sees = {"params": "the pose", "image": "the image"}.get(task["observation"], "both")
    return f"{evaluation.scores['agent']} (sees {sees}), {task['view']}: {count} fixed starts"


def _path(episodes: Any, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 3) mm and (T,) p of an episode up to its end."""
    steps = int(episodes.final["steps"][row])
    return episodes.positions[: steps + 1, row] * 1e3, episodes.probabilities[: steps + 1, row]


def _line(episodes: Any, row: int, milliseconds: float | None) -> str:
    steps = int(episodes.final["steps"][row])
    seen = "true view" if bool(episodes.final["success"][row]) else "no true view"
    time = f", {steps * milliseconds / 1e3:.2f} s" if milliseconds else ""
    return f"{row + 1}: {steps} steps, p {episodes.probabilities[steps, row]:.4f}{time}, {seen}"


def _draw_path(axes: Any, path: np.ndarray, probability: np.ndarray, number: int) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    segments = np.stack([path[:-1], path[1:]], 1)
    line = Line3DCollection(segments, cmap="viridis", linewidth=2.4)
    line.set_array(probability[1:])
    line.set_clim(0.0, 1.0)
    axes.add_collection3d(line)
    label = {"label": "start"} if number == 0 else {}
    axes.scatter(*path[0], marker="o", s=42, color="white", edgecolor="black", **label)
    label = {"label": "end"} if number == 0 else {}
    axes.scatter(*path[-1], marker="X", s=42, color="tab:red", edgecolor="black", **label)
    axes.text(*path[0], f"  {number + 1}", fontsize=10, weight="bold")


def _draw_block(axes: Any, core: Any) -> None:
    """Outline the block from its top some way down; the workspace's floor plan for a stand-in."""
    low, high = _corners(core)
    low[2] = max(low[2], high[2] - SHOWN_DEPTH)
    x = np.array([low[0], high[0], high[0], low[0], low[0]])
    y = np.array([low[1], low[1], high[1], high[1], low[1]])
    for height, style in ((high[2], "-"), (low[2], ":")):
        axes.plot(x, y, np.full(5, height), style, color="0.45", linewidth=1.0)
    for corner in range(4):
        ends = [x[corner]] * 2, [y[corner]] * 2, [low[2], high[2]]
        axes.plot(*ends, ":", color="0.45", linewidth=1.0)
    axes.text(low[0], low[1], low[2], "block", fontsize=8, color="0.35")


def _corners(core: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the block's least and greatest x, y, z, mm."""
    block = getattr(getattr(core.phantom, "config", None), "block", None)
    if block is not None:
        return np.array(block.minimum) * 1e3, np.array(block.maximum) * 1e3
    space = core.phantom.workspace
    return tuple(x.cpu().numpy() * 1e3 for x in (space.position_min, space.position_max))
