"""Environments and agents: the scanning tasks in Gymnasium and TorchRL, and their baselines.

Importing registers `racines/<VIEW>-v0` for the one heart, `racines/<organ>-<VIEW>-v0` for the other
installed organs, `racines/<VIEW>-patients-v0` and `-beating-v0`, and `racines/Replay-v0` for
recorded frames alone, with Gymnasium and does nothing else; torch is loaded when an environment is
made.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium

from racines_data.views import HEART, organs
from racines_envs.task.names import GOALS, HEART_TIER, REPLAY_ID, TIERS, task_id, task_name

if TYPE_CHECKING:
    from racines_envs.apis.torchrl_env import ScanEnv as ScanEnv

__all__ = ["ScanEnv", "register_tasks"]


def register_tasks(anatomy: str, views: Sequence[str] | None = None) -> list[str]:
    """Register the tasks of an anatomy with Gymnasium and return their ids.

    Importing this package does it for every organ whose entry point names its views.

    Args:
        anatomy: Its name in the entry points `racines.anatomies`, or `module:function`.
        views: The names of its views; without them the anatomy is built and asked.
    """
    if views is None:
        from racines_data.phantom.anatomy import anatomy_views

        views = anatomy_views(anatomy)
    for view in views:
        settings = {"view": view} | ({"anatomy": anatomy} if anatomy != HEART else {})
        _register(task_id(view, anatomy), settings)
    return [task_id(view, anatomy) for view in views]


def _register(name: str, settings: dict[str, Any]) -> None:
    gymnasium.register(
        id=name,
        entry_point="racines_envs.apis.gym_env:GymScanEnv",
        vector_entry_point="racines_envs.apis.gym_env:VectorScanEnv",
        kwargs=settings,
    )


gymnasium.register(
    id=REPLAY_ID,
    entry_point="racines_envs.apis.replay_env:GymReplayEnv",
    vector_entry_point="racines_envs.apis.replay_env:VectorReplayEnv",
)
for _tier in TIERS:
    for _view in GOALS if _tier != HEART_TIER else ():
        _register(task_id(_view, tier=_tier), {"view": task_name(_view, tier=_tier)})
for _anatomy, _views in organs().items():
    register_tasks(_anatomy, _views)


def __getattr__(name: str) -> Any:
    """Load the TorchRL environment when it is first asked for."""
    if name == "ScanEnv":
        from racines_envs.apis.torchrl_env import ScanEnv

        return ScanEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
