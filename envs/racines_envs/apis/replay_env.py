"""Recordings alone in Gymnasium: `racines/Replay-v0`, one environment, and N rows."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_envs.apis.gym_env import GymScanEnv, VectorScanEnv
from racines_envs.worlds.recorded.opening import open_recordings
from racines_envs.worlds.recorded.settings import ReplayConfig
from racines_envs.worlds.recorded.world import Recordings


class GymReplayEnv(GymScanEnv):
    """Find a view, or a frame, in recordings with one probe."""

    def __init__(
        self, data: Path | str | Recordings | None = None, view: str = "",
        render_mode: str | None = None, **settings: Any,
    ) -> None:  # fmt: skip
        """Open a dataset's folder, data/racines by default, or take open recordings.

        Args:
            data: Whose frames.
            view: One of their views, where there is no `goal`.
            render_mode: As of every environment.
            settings: Those of `ReplayConfig`, by name, and of `make_core`.
        """
        world, rest = _opened(data, view, settings)
        super().__init__(world.aim.view, render_mode, phantom=world, **rest)


class VectorReplayEnv(VectorScanEnv):
    """The same with N probes."""

    def __init__(
        self, data: Path | str | Recordings | None = None, view: str = "", num_envs: int = 1,
        render_mode: str | None = None, **settings: Any,
    ) -> None:  # fmt: skip
        """Build N rows; settings as for `GymReplayEnv`."""
        world, rest = _opened(data, view, settings)
        super().__init__(world.aim.view, num_envs, render_mode, phantom=world, **rest)


def _opened(
    data: Path | str | Recordings | None, view: str, settings: dict[str, Any]
) -> tuple[Recordings, dict[str, Any]]:
    """Return the recordings, and the settings that are not theirs."""
    known = {field.name for field in fields(ReplayConfig)}
    own = {name: value for name, value in settings.items() if name in known}
    rest = {name: value for name, value in settings.items() if name not in known}
    if isinstance(data, Recordings):
        if own:
            named = ", ".join(own)
            raise RacinesError(f"recordings that are open have their settings: {named} comes late")
        return data, rest
    device: torch.device | str = rest.get("device", "cpu")
    return open_recordings(data, view, fill(ReplayConfig, own, "replay"), device), rest
