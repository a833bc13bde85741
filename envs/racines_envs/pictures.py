"""Pictures of what agents did."""

import io
from pathlib import Path
from typing import Any

import numpy as np


def draw_trajectories(evaluation: Any, path: Path) -> None:
    """Draw the probe's path from several starts, in 3-D, as PNG; mm in the robot base frame."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    from racines_data.files import write_atomic

    episodes, core, scores = evaluation.episodes, evaluation.core, evaluation.scores
    count = min(evaluation.pictured, len(episodes.final["steps"]))
    figure = plt.figure(figsize=(7.0, 6.0))
    axes: Any = figure.add_subplot(projection="3d")
    for row in range(count):
        _draw_path(axes, episodes, row)
    target = core.target.position[0].cpu().numpy() * 1e3
    axes.scatter(*target, marker="*", s=160, color="black", label="nominal pose")
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
    axes.set_title(f"{scores['agent']}, {core.task.view}: {count} of the fixed starts")
    axes.legend(loc="upper left", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    plt.close(figure)
    write_atomic(path, buffer.getvalue())


def _draw_path(axes: Any, episodes: Any, row: int) -> None:
    steps = int(episodes.final["steps"][row])
    path = episodes.positions[: steps + 1, row] * 1e3
    seen = "true view" if bool(episodes.final["success"][row]) else "no true view"
    label = f"{steps} steps, p {episodes.probabilities[steps, row]:.2f}, {seen}"
    (line,) = axes.plot(*path.T, marker=".", markersize=3, linewidth=1.2, label=label)
    colour = line.get_color()
    axes.scatter(*np.transpose(path[:1]), marker="o", s=36, color=colour)
    axes.scatter(*np.transpose(path[-1:]), marker="X", s=48, color=colour)
