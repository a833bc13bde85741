"""Pictures of what agents did."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from racines_data.files import write_atomic
from racines_data.plotting import EDGE, GRID, INK, LEVELS, MUTED, card_style, encode
from racines_envs.task.core import ScanCore
from racines_envs.worlds.recorded.world import Recordings

DPI = 140
MARGIN = 6.0  # mm, shown around the paths


@card_style()
def draw_trajectories(evaluation: Any, path: Path) -> None:
    """Draw the probe's path from several starts, in 3-D, as PNG; mm in the robot base frame.

    In recordings that stand alone the recorded positions are drawn in the place of the block.
    The colour is the confidence p by the reward's own source; steps, p and, where one decision was
    timed, the time are written below. A floor plan shows where on the block's top that is.
    """
    episodes, core, scores = evaluation.episodes, evaluation.core, evaluation.scores
    count = min(evaluation.pictured, len(episodes.final["steps"]))
    ends = [int(steps) for steps in episodes.final["steps"][:count]]
    paths = [episodes.positions[: end + 1, row] * 1e3 for row, end in enumerate(ends)]
    target = core.target.position[0].cpu().numpy() * 1e3
    figure = Figure(figsize=(8.6, 6.6))
    axes: Any = figure.add_axes((0.0, 0.1, 0.72, 0.84), projection="3d")
    for row, end in enumerate(ends):
        _draw_path(axes, paths[row], episodes.probabilities[: end + 1, row], row)
    axes.scatter(*target, marker="*", s=150, color="black", label="nominal pose")
    _frame(axes, np.concatenate([target[None], *paths]), core)
    _draw_plan(figure.add_axes((0.7, 0.12, 0.27, 0.27)), core, paths, target)
    scale = ScalarMappable(Normalize(0.0, 1.0), LEVELS)
    bar = figure.add_axes((0.82, 0.5, 0.02, 0.36))
    figure.colorbar(scale, cax=bar, label=f"p of {core.task.view}, by the {core.reward.judged_by}")
    milliseconds = scores["metrics"].get("latency", {}).get("value")
    lines = []
    for row, end in enumerate(ends):
        time = f", {end * milliseconds / 1e3:.2f} s" if milliseconds else ""
        seen = "true view" if bool(episodes.final["success"][row]) else "no true view"
        p = episodes.probabilities[end, row]
        lines.append(f"{row + 1}: {end} steps, p {p:.4f}{time}, {seen}")
    figure.text(0.03, 0.03, "\n".join(lines), fontsize=8.5, va="bottom", family="monospace")
    names = {"params": "the pose", "image": "the image", "multimodal": "both"}
    sees = names.get(scores["sees"], scores["sees"])
    title = f"{scores['agent']} (sees {sees}), {scores['task']['view']}: {count} fixed starts"
    figure.text(0.03, 0.95, title, fontsize=11)
    axes.legend(loc="upper left", fontsize=8)
    save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, aside first."""
    write_atomic(path, encode(figure, few=False, dpi=DPI))


def _draw_path(axes: Any, path: np.ndarray, probability: np.ndarray, number: int) -> None:
    segments = np.stack([path[:-1], path[1:]], 1)
    line = Line3DCollection(segments, cmap=LEVELS, linewidth=2.4)
    line.set_array(probability[1:])
    line.set_clim(0.0, 1.0)
    axes.add_collection3d(line)
    start, end = ("start", "end") if number == 0 else (None, None)
    axes.scatter(*path[0], marker="o", s=42, color="white", edgecolor="black", label=start)
    colour = {"c": probability[-1:], "cmap": LEVELS, "vmin": 0.0, "vmax": 1.0, "label": end}
    axes.scatter(*path[-1:].T, marker="X", s=60, edgecolor="black", depthshade=False, **colour)
    axes.text(*path[0], f"  {number + 1}", fontsize=10, weight="bold")


def _frame(axes: Any, points: np.ndarray, core: ScanCore) -> None:
    """Show the space around the paths, and the part of the block's top that lies in it."""
    low, high = points.min(0) - MARGIN, points.max(0) + MARGIN
    unit, recorded = _recorded(core)
    if recorded is None:
        top = _corners(core)[1][2]
        low[2], high[2] = points[:, 2].min() - 1.0, max(points[:, 2].max(), top) + 1.0
        x, y = np.meshgrid([low[0], high[0]], [low[1], high[1]])
        axes.plot_surface(x, y, np.full((2, 2), top), color=MUTED, alpha=0.22)
        axes.text(high[0], low[1], top, "block's top", fontsize=8, color=MUTED, ha="right")
    else:
        near = recorded[((recorded >= low) & (recorded <= high)).all(1)]
        axes.scatter(*near.T, s=3, color=MUTED, alpha=0.4, label="recorded")
        axes.set(zlim=(low[2], high[2]))
    axes.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}", zlabel=f"z, {unit}")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1.0, 1.0, 0.6))  # the height, in which the probe moves least, is stretched
    axes.view_init(elev=28.0, azim=-60.0)


def _draw_plan(axes: Any, core: ScanCore, paths: list[np.ndarray], target: np.ndarray) -> None:
    """Draw the paths from above on the block's outline (a stand-in's workspace)."""
    low, high = _corners(core)
    size = (high - low)[:2]
    unit, recorded = _recorded(core)
    if recorded is None:
        axes.add_patch(Rectangle((low[0], low[1]), *size, facecolor=GRID, edgecolor=MUTED))
    else:
        axes.scatter(*recorded[:, :2].T, s=1, color=EDGE)
    for number, path in enumerate(paths):
        axes.plot(path[:, 0], path[:, 1], color=INK, linewidth=0.9)
        axes.text(path[0, 0], path[0, 1], str(number + 1), fontsize=7)
    axes.plot(*target[:2], "*", color="black", markersize=8)
    axes.set(xlim=(low[0] - 5, high[0] + 5), ylim=(low[1] - 5, high[1] + 5), aspect="equal")
    what = "block" if recorded is None else "recorded"
    axes.set_title(f"{what} from above, {unit}", fontsize=8)
    axes.tick_params(labelsize=7)


def _recorded(core: ScanCore) -> tuple[str, np.ndarray | None]:
    """Return the unit of lengths, and the (M, 3) recorded positions; of a phantom none."""
    if not isinstance(core.phantom, Recordings):
        return "mm", None
    return core.phantom.unit, core.phantom.frames.pose.position.cpu().numpy() * 1e3


def _corners(core: ScanCore) -> tuple[np.ndarray, np.ndarray]:
    """Return the block's least and greatest x, y, z, mm."""
    if core.phantom.config is not None:
        block = core.phantom.config.block
        return np.array(block.minimum) * 1e3, np.array(block.maximum) * 1e3
    space = core.phantom.workspace
    return space.position_min.cpu().numpy() * 1e3, space.position_max.cpu().numpy() * 1e3
