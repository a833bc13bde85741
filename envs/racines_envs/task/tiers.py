"""What the tasks on patients have of their own: their time, and where their episodes start.

A start is drawn about a view's middle, its nominal pose in the mean over train patients, whoever
lies there: so where an episode starts says nothing of where this patient's heart is. The middles
are part of the tasks' rules, written down once; they need not follow when patients change a little.
"""

import torch
from torch import Tensor

from racines_data.geometry import Pose, euler_to_matrix
from racines_data.views import VIEWS

STEP_SECONDS = 0.1
"""What one step of an environment takes."""
LONGEST = 60.0
"""An episode begins so late in the patient's rhythm at most, s."""

MIDDLES = {
    "A4C": (0.407, -0.034, 0.059, -2.50, 0.37, -1.46),
    "SC": (0.424, 0.071, 0.059, -2.54, -0.33, -1.89),
    "PL": (0.518, 0.026, 0.059, -3.04, 0.30, 0.65),
    "PSAV": (0.573, 0.075, 0.059, 2.47, 0.03, -0.85),
    "PSMV": (0.547, 0.064, 0.059, 2.46, 0.03, -0.85),
}
"""Position, m, and extrinsic xyz angles, rad, base frame: means over the train patients 1-120,
rounded. The patients' own nominal poses lie 30 mm and 13° from there (medians)."""


def middles(labels: Tensor) -> Pose:
    """Return the (N,) poses about which episodes with goals of (N,) labels start."""
    table = torch.tensor([MIDDLES[view] for view in VIEWS], device=labels.device)[labels]
    return Pose(table[:, :3], euler_to_matrix(table[:, 3:]))
