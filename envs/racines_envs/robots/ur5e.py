"""Universal Robots' UR5e, as the arm of the paper holds its probe."""

import math

from racines_envs.robots.arm import Arm, Link

RIGHT = math.pi / 2
UR5E = Arm(
    name="ur5e",
    links=(
        Link(0.0, 0.1625, RIGHT),
        Link(-0.425, 0.0, 0.0),
        Link(-0.3922, 0.0, 0.0),
        Link(0.0, 0.1333, RIGHT),
        Link(0.0, 0.0997, -RIGHT),
        Link(0.0, 0.0996, 0.0),
    ),
    limits=((-2 * math.pi, 2 * math.pi),) * 6,
    speeds=(math.pi,) * 6,
    home=(2.94, -1.35, 2.11, -2.32, -RIGHT, -1.77),
    tool=0.15,
    source=(
        "Universal Robots, DH parameters for calculations of kinematics and dynamics, and UR5e "
        "technical specifications"
    ),
)
