"""Poses around nominal ones, as hands that hold a probe stray."""

import math

from racines_data.geometry import Pose, euler_to_matrix
from racines_data.phantom.acquisition import coordinates
from racines_data.randomness import normal, sample_seeds

JITTER = (0.0025, 0.0025, 0.0005, 0.04, 0.04, 0.04)
"""Standard deviation of poses around nominal ones: m, and rad of the Euler angles."""


def scattered(targets: Pose, seed: int) -> Pose:
    """Return (N,) poses scattered by `JITTER` around (N,) ones."""
    count = len(targets.position)
    noise = normal(sample_seeds(seed, 1), 6 * count, 71).view(count, 6)
    path = coordinates(targets).cpu() + noise * noise.new_tensor(JITTER)
    angles = path[:, 3:] + path.new_tensor([math.pi, 0.0, 0.0])
    return Pose(path[:, :3].contiguous(), euler_to_matrix(angles))
