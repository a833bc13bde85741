"""The figure of an explanation: the images of an episode with what moved the decision."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_envs.explain.explanation import Explanation
from racines_envs.explain.scores import blur
from racines_envs.task.actions import ACTIONS

COLUMNS = 6
"""Images in a figure at most; evenly taken from the episode's."""
_SOFT = 1.2
"""Blur of the drawn attributions, pixels; the scores are taken without."""


def draw_episode(explanation: Explanation, row: int, path: Path) -> None:
    """Draw the images of an episode over their attributions, as PNG.

    Red speaks for the chosen action (or the target view), blue against; green lines are true
    borders of tissues.
    """
    from matplotlib.figure import Figure

    from racines_data.files import write_atomic

    chosen = (explanation.frames.row == row).nonzero().squeeze(1)
    if len(chosen) > COLUMNS:
        chosen = chosen[torch.linspace(0, len(chosen) - 1, COLUMNS).round().long()]
    kinds = list(explanation.maps)
    lines = 1 + len(kinds)
    size = (1.9 * len(chosen) + 0.6, 2.15 * lines + 0.35)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = figure.subplots(lines, len(chosen), squeeze=False)
    for column, index in enumerate(chosen.tolist()):
        frames = explanation.frames
        action = ACTIONS[int(frames.actions[index])]
        axes[0, column].set_title(f"step {int(frames.step[index])}: {action}", fontsize=9)
        image = frames.images[index].cpu().numpy()
        axes[0, column].imshow(image, cmap="gray", vmin=0, vmax=255)
        for line, kind in enumerate(kinds, 1):
            axis = axes[line, column]
            _overlay(axis, image, explanation.maps[kind][index])
            borders = explanation.regions.get("borders")
            if borders is not None:
                axis.contour(borders[index].cpu().numpy(), [0.5], colors="lime", linewidths=0.25)
            found = float(explanation.probabilities[kind][index])
            axis.set_title(f"p {found:.2f}", fontsize=8, pad=2)
    titles = {"policy": "chosen action", "grader": "target view,\nby the grader"}
    for line, label in enumerate(["image", *(titles[kind] for kind in kinds)]):
        axes[line, 0].set_ylabel(label, fontsize=9)
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    view = explanation.scores["settings"]["view"]
    figure.suptitle(f"{explanation.scores['agent']} on {view}, start {row}", fontsize=10)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=130, metadata={"Software": None})
    write_atomic(path, buffer.getvalue())


def _overlay(axis: Any, image: np.ndarray, drawn: Tensor) -> None:
    """Lay a softened attribution over an image; the strongest hundredth is opaque."""
    soft = blur(drawn.unsqueeze(0).cpu(), _SOFT)[0].numpy()
    scale = max(float(np.quantile(np.abs(soft), 0.99)), 1e-12)
    strength = np.clip(np.abs(soft) / scale, 0.0, 1.0)
    axis.imshow(image * 0.7, cmap="gray", vmin=0, vmax=255)
    axis.imshow(soft, cmap="seismic", vmin=-scale, vmax=scale, alpha=strength**0.8)
