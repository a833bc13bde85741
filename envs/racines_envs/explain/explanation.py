"""What an explanation holds: the frames of an agent's episodes, attributions, scores."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from racines_data.geometry import Pose


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
