"""The one reading of a device's name, for every `--device`, `Run` and config of the project."""

import os
from dataclasses import replace
from typing import Any, TypeVar

import torch

from racines_data.errors import RacinesError

C = TypeVar("C")


def resolve_device(device: torch.device | str) -> str:
    """Return the device that `auto` stands for (CUDA if there is one), or the one named, if there.

    Names are `auto`, `cpu`, `cuda` and `cuda:N`. Of several processes on a machine each has its own
    CUDA device, by its local rank.
    """
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    here = ["cpu", *(["cuda"] if count else []), *(f"cuda:{n}" for n in range(count))]
    device = str(device)
    if device == "auto":
        device = here[min(1, len(here) - 1)]
    if device not in here:
        raise RacinesError(f"device {device!r}: there is none here: use auto, {', '.join(here)}")
    if device == "cuda" and "LOCAL_RANK" in os.environ:
        return f"cuda:{os.environ['LOCAL_RANK']}"
    return device


def on_device(config: C) -> C:
    """Return a config with what its `device` stands for; raises as `resolve_device`."""
    settings: Any = config
    return replace(settings, device=resolve_device(settings.device))
