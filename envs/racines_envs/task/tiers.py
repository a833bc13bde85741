"""What the tasks on patients have of their own: their time, and where their episodes start.

A start is drawn about a view's middle, its nominal pose in the mean over train patients, whoever
lies there: so where an episode starts says nothing of where this patient's heart is.
"""

import torch
from torch import Tensor

from racines_data.geometry import Pose, euler_to_matrix
from racines_data.views import MIDDLES, VIEWS
from racines_data.world import LONGEST, STEP_SECONDS

__all__ = ["LONGEST", "MIDDLES", "STEP_SECONDS", "middles"]


def middles(labels: Tensor) -> Pose:
    """Return the (N,) poses about which episodes with goals of (N,) labels start."""
    table = torch.tensor([MIDDLES[view] for view in VIEWS], device=labels.device)[labels]
    return Pose(table[:, :3], euler_to_matrix(table[:, 3:]))
