"""Pictures of what agents did."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from racines_envs.task.core import ScanCore

MARGIN = 6.0
"""Shown around the paths, mm."""


def draw_trajectories(evaluation: Any, path: Path) -> None:
    """Draw the probe's path from several starts, in 3-D, as PNG; mm in the robot base frame.

    The colour is the confidence p by the reward's own source; steps, p and, where one decision was
    timed, the time are written below. A floor plan shows where on the block's top that is.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    episodes, core, scores = evaluation.episodes, evaluation.core, evaluation.scores
    count = min(evaluation.pictured, len(episodes.final["steps"]))
    paths = [_path(episodes, row) for row in range(count)]
    target = core.target.position[0].cpu().numpy() * 1e3
    figure = plt.figure(figsize=(8.6, 6.6))
    axes: Any = figure.add_axes((0.0, 0.1, 0.72, 0.84), projection="3d")
    for number, (path_, probability) in enumerate(paths):
        _draw_path(axes, path_, probability, number)
    axes.scatter(*target, marker="*", s=150, color="black", label="nominal pose")
    _frame(axes, np.concatenate([target[None], *(path_ for path_, _ in paths)]), core)
    _draw_plan(figure.add_axes((0.7, 0.12, 0.27, 0.27)), core, paths, target)
    scale = ScalarMappable(Normalize(0.0, 1.0), "viridis")
    bar = figure.add_axes((0.82, 0.5, 0.02, 0.36))
    figure.colorbar(scale, cax=bar, label=f"p of {core.task.view}, by the {core.reward.judged_by}")
    milliseconds = scores["metrics"].get("latency", {}).get("value")
    lines = [_line(episodes, row, milliseconds) for row in range(count)]
    figure.text(0.03, 0.03, "\n".join(lines), fontsize=8.5, va="bottom", family="monospace")
    figure.text(0.03, 0.95, _title(evaluation, count), fontsize=11)
    axes.legend(loc="upper left", fontsize=8)
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
    names = {"params": "the pose", "image": "the image", "multimodal": "both"}
    sees = evaluation.scores["sees"]
    return (
        f"{evaluation.scores['agent']} (sees {names.get(sees, sees)}), {task['view']}: "
        f"{count} fixed starts"
    )


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
    colour = {"c": probability[-1:], "cmap": "viridis", "vmin": 0.0, "vmax": 1.0}
    end = path[-1:].T
    axes.scatter(*end, marker="X", s=60, edgecolor="black", depthshade=False, **colour, **label)
    axes.text(*path[0], f"  {number + 1}", fontsize=10, weight="bold")


def _frame(axes: Any, points: np.ndarray, core: ScanCore) -> None:
    """Show the space around the paths, and the part of the block's top that lies in it."""
    low, high = points.min(0) - MARGIN, points.max(0) + MARGIN
    top = _corners(core)[1][2]
    low[2], high[2] = points[:, 2].min() - 1.0, max(points[:, 2].max(), top) + 1.0
    x, y = np.meshgrid([low[0], high[0]], [low[1], high[1]])
    axes.plot_surface(x, y, np.full((2, 2), top), color="0.6", alpha=0.22)
    axes.text(high[0], low[1], top, "block's top", fontsize=8, color="0.35", ha="right")
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1.0, 1.0, 0.6))  # the height, in which the probe moves least, is stretched
    axes.view_init(elev=28.0, azim=-60.0)


def _draw_plan(axes: Any, core: ScanCore, paths: list[Any], target: np.ndarray) -> None:
    """Draw the paths from above on the block's outline (a stand-in's workspace)."""
    from matplotlib.patches import Rectangle

    low, high = _corners(core)
    size = high - low
    axes.add_patch(Rectangle((low[0], low[1]), size[0], size[1], facecolor="0.92", edgecolor="0.4"))
    for number, (path, _) in enumerate(paths):
        axes.plot(path[:, 0], path[:, 1], color="0.3", linewidth=0.9)
        axes.text(path[0, 0], path[0, 1], str(number + 1), fontsize=7)
    axes.plot(*target[:2], "*", color="black", markersize=8)
    axes.set(xlim=(low[0] - 5, high[0] + 5), ylim=(low[1] - 5, high[1] + 5), aspect="equal")
    axes.set_title("block from above, mm", fontsize=8)
    axes.tick_params(labelsize=7)


def _corners(core: ScanCore) -> tuple[np.ndarray, np.ndarray]:
    """Return the block's least and greatest x, y, z, mm."""
    if core.phantom.config is not None:
        block = core.phantom.config.block
        return np.array(block.minimum) * 1e3, np.array(block.maximum) * 1e3
    space = core.phantom.workspace
    return space.position_min.cpu().numpy() * 1e3, space.position_max.cpu().numpy() * 1e3
