"""An arm that is not in the package: one file with one `Arm`, of seven joints."""

import math

from racines_envs.robots.arm import Arm, Link

RIGHT = math.pi / 2
PANDA = Arm(
    name="panda",
    links=(
        Link(0.0, 0.333, -RIGHT),
        Link(0.0, 0.0, RIGHT),
        Link(0.0825, 0.316, RIGHT),
        Link(-0.0825, 0.0, -RIGHT),
        Link(0.0, 0.384, RIGHT),
        Link(0.088, 0.0, RIGHT),
        Link(0.0, 0.107, 0.0),
    ),
    limits=(
        (-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698),
        (-2.8973, 2.8973), (-0.0175, 3.7525), (-2.8973, 2.8973),
    ),
    speeds=(2.175,) * 4 + (2.61,) * 3,
    home=(0.0, -0.1, 0.0, -2.5, 0.0, 2.4, 0.0),
    tool=0.15,
    source="Franka Emika Panda: Denavit-Hartenberg parameters, limits and speeds",
)  # fmt: skip
