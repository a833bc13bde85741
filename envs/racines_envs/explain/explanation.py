"""What an explanation holds, and its files: scores, attributions, and pictures of episodes."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.files import write_atomic, write_json
from racines_data.geometry import Pose
from racines_envs.explain.scores import blur
from racines_envs.task.actions import ACTIONS

COLUMNS = 6
"""Images in a figure at most; evenly taken from the episode's."""
TITLES = {"policy": "chosen action", "grader": "target view,\nby the grader"}
_SOFT = 1.2
"""Blur of the drawn attributions, pixels; the scores are taken without."""


@dataclass(frozen=True)
class Shown:
    """The images of an agent's episodes that are explained, n in all."""

    images: Tensor
    """(n, 128, 128) uint8."""
    params: Tensor
    """(n, 9); zeros where the agent does not look at them."""
    pose: Pose
    actions: Tensor
    """(n,) int64, what the agent did there."""
    row: Tensor
    """(n,) int64, the episode."""
    step: Tensor
    """(n,) int64, steps before it."""


@dataclass(frozen=True)
class Explanation:
    """Attributions and their scores."""

    scores: dict[str, Any]
    frames: Shown
    maps: dict[str, Tensor]
    """(n, 128, 128) attributions of the chosen action (`policy`) and the target view (`grader`)."""
    regions: dict[str, Tensor]
    """(n, 128, 128) bool, inside the sector; see `true_regions`."""
    probabilities: dict[str, Tensor]
    """(n,) probability of what is attributed."""


def write_explanation(explanation: Explanation, folder: Path, pictures: int = 4) -> None:
    """Write `explanation.json`, `attributions.npz`, and a picture of each of the first episodes."""
    frames, buffer = explanation.frames, io.BytesIO()
    arrays = explanation.maps | {
        "images": frames.images,
        "episode": frames.row,
        "step": frames.step,
        "action": frames.actions,
    }
    whole: Any = {name: values.cpu().numpy() for name, values in arrays.items()}
    np.savez_compressed(buffer, **whole)
    write_atomic(folder / "attributions.npz", buffer.getvalue())
    for row in frames.row.unique().tolist()[:pictures]:
        draw_episode(explanation, row, folder / f"episode_{row:02d}.png")
    write_json(folder / "explanation.json", explanation.scores)


def draw_episode(explanation: Explanation, row: int, path: Path) -> None:
    """Draw the images of an episode over their attributions, as PNG.

    Red speaks for the chosen action (or the target view), blue against; green lines are true
    borders of tissues.
    """
    from matplotlib.figure import Figure

    frames, kinds = explanation.frames, list(explanation.maps)
    chosen = (frames.row == row).nonzero().squeeze(1)
    if len(chosen) > COLUMNS:
        chosen = chosen[torch.linspace(0, len(chosen) - 1, COLUMNS).round().long()]
    lines = 1 + len(kinds)
    size = (1.9 * len(chosen) + 0.6, 2.15 * lines + 0.35)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = figure.subplots(lines, len(chosen), squeeze=False)
    for index, column in zip(chosen.tolist(), axes.T, strict=True):
        action = ACTIONS[int(frames.actions[index])]
        image = frames.images[index].cpu().numpy()
        column[0].set_title(f"step {int(frames.step[index])}: {action}", fontsize=9)
        column[0].imshow(image, cmap="gray", vmin=0, vmax=255)
        for kind, axis in zip(kinds, column[1:], strict=True):
            _overlay(axis, image, explanation.maps[kind][index])
            if "borders" in explanation.regions:
                borders = explanation.regions["borders"][index].cpu().numpy()
                axis.contour(borders, [0.5], colors="lime", linewidths=0.25)
            found = float(explanation.probabilities[kind][index])
            axis.set_title(f"p {found:.2f}", fontsize=8, pad=2)
    for axis, label in zip(axes[:, 0], ["image", *(TITLES[kind] for kind in kinds)], strict=True):
        axis.set_ylabel(label, fontsize=9)
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
