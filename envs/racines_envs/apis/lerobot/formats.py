"""What LeRobot's policies see and do: as recorded, or as the tasks have it.

    lerobot-rgb     12 parameters, with forces; velocities in the base frame
    lerobot-task    the pose's nine numbers, as agents see them; twists in the probe's frame

Exports (`racines data export`) and environments (`racines export envhub`) of one `--format` fit
each other. Policies of `lerobot-task` come back to the agents' board as ONNX files.
"""

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.pacing import FREE, joint_count
from racines_data.schema import CONTROLS, PARAMETERS

RECORDED, TASK = "lerobot-rgb", "lerobot-task"
FORMATS = (RECORDED, TASK)
CAMERA, JOINTS = "ultrasound", "joints"
POSE: tuple[str, ...] = ("x", "y", "z", *(f"{column}_{axis}" for column in "ab" for axis in "xyz"))
"""Names of the nine numbers: place in the workspace's box, first and second column of rotation."""
TWIST: tuple[str, ...] = tuple(name.replace("control", "twist") for name in CONTROLS)


def check_format(name: str) -> str:
    """Return a format's name.

    Raises:
        RacinesError: there is none of that name.
    """
    if name not in FORMATS:
        raise RacinesError(f"--format {name}: choose one of {', '.join(FORMATS)}")
    return name


def features_of(name: str, robot: str = FREE) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return type and shape of what an environment gives and takes, by LeRobot's `EnvConfig` keys.

    Where an arm carries the probe its joints are given too, as exports of sweeps for it have them.

    Raises:
        RacinesError: no such format, no such arm, or a package that the arm needs is not installed.
    """
    state = POSE if check_format(name) == TASK else PARAMETERS
    joints = {} if robot == FREE else {JOINTS: ("STATE", (joint_count(robot),))}
    return {
        f"pixels/{CAMERA}": ("VISUAL", (IMAGE_SIZE, IMAGE_SIZE, 3)),
        "agent_pos": ("STATE", (len(state),)),
        **joints,
        "action": ("ACTION", (len(TWIST),)),
    }


def twist_of(velocity: Tensor, rotation: Tensor) -> Tensor:
    """Return (B, 6) twists in the probe's frame of (B, 6) velocities in the base frame.

    Args:
        velocity: m/s and rad/s.
        rotation: (B, 3, 3), from the probe's frame to the base's.
    """
    parts = velocity.view(-1, 2, 3).to(rotation)
    return torch.einsum("bpi,bij->bpj", parts, rotation).reshape(-1, 6)
