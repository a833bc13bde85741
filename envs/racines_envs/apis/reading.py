"""What callers of the Gymnasium environments may give, read and checked."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, euler_to_matrix
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.task.motion import Velocity
from racines_envs.worlds.ward import Ward

OPTIONS = ("pose", "patient")
"""What a reset may be told."""


def action_space(core: ScanCore) -> spaces.Space[Any]:
    """Return the space of one row's action: 13 steps, or a twist in m/s and rad/s."""
    if isinstance(core.motion, Velocity):
        limits = core.motion.limits.cpu().numpy()
        return spaces.Box(-limits, limits, dtype=np.float32)
    return spaces.Discrete(len(ACTIONS))


def read_actions(actions: Any, core: ScanCore) -> torch.Tensor:
    """Turn the actions of all rows, in any kind of sequence, into a tensor of (N,) or (N, 6)."""
    twists = isinstance(core.motion, Velocity)
    wanted = "twists of six numbers, m/s and rad/s" if twists else "integers 0-12"
    try:
        array = np.asarray(actions)
    except ValueError as error:
        raise RacinesError(f"actions {actions!r} are ragged: give {wanted}") from error
    whole = array.dtype.kind in "iu" and array.shape[-1:] == (6,)
    if twists and (array.dtype.kind == "f" or whole):
        array = array.astype(np.float32) if whole else array
        alone = array.shape == (6,) and core.num_envs == 1
        return torch.as_tensor(array.astype(np.float32)[None] if alone else array)
    if array.dtype.kind not in "iu":
        kind = "of the wrong kind" if twists else "no integer"
        raise RacinesError(f"action {actions!r} is {kind}: give {wanted}")
    return torch.as_tensor(np.atleast_1d(array).astype(np.int64))


def read_pose(options: dict[str, Any] | None, count: int) -> Pose | None:
    """Read `options["pose"]`: (6,) or (count, 6) m and extrinsic xyz angles rad."""
    options = options or {}
    unknown = set(options) - set(OPTIONS)
    if unknown:
        known = " and ".join(map(repr, OPTIONS))
        raise RacinesError(f"unknown reset option {sorted(unknown)[0]!r}: known are {known}")
    if "pose" not in options:
        return None
    try:
        values = torch.as_tensor(np.asarray(options["pose"], dtype=np.float32))
    except (TypeError, ValueError) as error:
        raise RacinesError(
            f"options['pose'] is no numbers ({options['pose']!r}): give position in m and angles "
            "in rad"
        ) from error
    if values.shape not in ((6,), (count, 6)):
        raise RacinesError(
            f"options['pose'] has shape {tuple(values.shape)}: give (6,) or ({count}, 6), position "
            "in m and angles in rad"
        )
    values = values.expand(count, 6)
    return Pose(values[:, :3], euler_to_matrix(values[:, 3:]))


def read_case(options: dict[str, Any] | None, core: ScanCore) -> torch.Tensor | None:
    """Read `options["patient"]`: the seed of a patient of the environment, or one for each row."""
    if not options or "patient" not in options:
        return None
    if not isinstance(core.phantom, Ward):
        raise RacinesError(f"options['patient']: {core.task.id} has one heart and no patients")
    patients = np.asarray(options["patient"])
    if patients.dtype.kind not in "iu" or patients.shape not in ((), (core.num_envs,)):
        raise RacinesError(
            f"options['patient'] is {options['patient']!r}: give a patient's seed, or a list of "
            f"{core.num_envs}, one a row"
        )
    return core.phantom.case_of(np.broadcast_to(patients, core.num_envs).tolist())


def read_seeds(seed: Any, count: int) -> int | torch.Tensor | None:
    """Turn Gymnasium's seed of a vector environment into one integer or (count,) int64."""
    if seed is None:
        return None
    array = np.asarray(seed)
    if array.dtype.kind not in "iu" or array.shape not in ((), (count,)):
        raise RacinesError(f"seed {seed!r}: give one integer, or a list of {count}, one a row")
    return int(array) if array.ndim == 0 else torch.as_tensor(array.astype(np.int64))


def take_mask(
    options: dict[str, Any] | None, count: int
) -> tuple[torch.Tensor | None, dict[str, Any]]:
    """Take Gymnasium's `reset_mask`, (count,) bool, out of options; None stands for all rows.

    The options that are left are a copy.
    """
    rest = dict(options or {})
    if "reset_mask" not in rest:
        return None, rest
    given = rest.pop("reset_mask")
    mask = np.asarray(given)
    if mask.dtype != np.bool_ or mask.shape != (count,) or not mask.any():
        raise RacinesError(
            f"options['reset_mask'] is {given!r}: give ({count},) bool, at least one of them true"
        )
    return torch.as_tensor(mask), rest


def read_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Read when rows that end begin anew: Gymnasium's mode, or its value as in `SyncVectorEnv`."""
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        known = ", ".join(repr(each.value) for each in AutoresetMode)
        raise RacinesError(f"unknown autoreset_mode {mode!r}: choose one of {known}") from error
