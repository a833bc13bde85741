"""Environments and agents: the scanning tasks in Gymnasium and TorchRL, and their baselines.

Importing registers `racines/<VIEW>-v0` with Gymnasium and does nothing else; torch is loaded when
an environment is made.
"""

from typing import TYPE_CHECKING, Any

import gymnasium

from racines_data.views import VIEWS

if TYPE_CHECKING:
    from racines_envs.torchrl_env import ScanEnv as ScanEnv

__all__ = ["ScanEnv"]

for _view in VIEWS:
    gymnasium.register(
        id=f"racines/{_view}-v0",
        entry_point="racines_envs.gym_env:GymScanEnv",
        vector_entry_point="racines_envs.gym_vector:VectorScanEnv",
        kwargs={"view": _view},
    )


def __getattr__(name: str) -> Any:
    """Load the TorchRL environment when it is first asked for."""
    if name == "ScanEnv":
        from racines_envs.torchrl_env import ScanEnv

        return ScanEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
