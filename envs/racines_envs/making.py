"""From names to a core: what `gymnasium.make`, `ScanEnv` and the evaluation all call."""

import dataclasses
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_envs.backends import GRADER_FOLDER, make_backend, make_grader
from racines_envs.core import ScanCore
from racines_envs.rewards import RewardConfig
from racines_envs.tasks import Task, get_task


def make_core(
    view: str | Task,
    num_envs: int = 1,
    *,
    backend: str | ImageSource = "phantom",
    observation: str = "image",
    reward: str = "paper",
    phantom: Any = None,
    generator: Any = None,
    grader: Any = None,
    termination: str | None = None,
    rewards: RewardConfig | None = None,
    device: torch.device | str = "cpu",
) -> ScanCore:
    """Build the batched core of a task.

    Args:
        view: A target view, or a task of your own.
        num_envs: Rows.
        backend: `phantom`, `generator`, or an object that makes images of parameters.
        observation: `image`, `params` or `multimodal`.
        reward: `paper` (by the grader), `oracle` (the same by the phantom's truth) or `shaped`.
        phantom: A phantom or its configuration; the shared default by default.
        generator: Name, run folder or object, for the backend `generator`.
        grader: Run folder or object; models/runs/grader for reward `paper`.
        termination: Instead of the task's: `first_hit`, `k_hits` or `timeout`.
        rewards: The numbers of the reward.
        device: Where the tensors live.

    Raises:
        RacinesError: any name that is unknown or any artefact that is not there.
    """
    task = view if isinstance(view, Task) else get_task(view)
    if termination is not None:
        task = dataclasses.replace(task, termination=termination)
    if reward == "paper" and grader is None:
        grader = GRADER_FOLDER
    if grader is not None:
        grader = make_grader(grader, device)
    phantom = make_phantom(phantom, device)
    images = make_backend(backend, phantom, generator, device)
    return ScanCore(task, phantom, images, grader, observation, reward, rewards, num_envs, device)


def make_phantom(phantom: Any, device: torch.device | str = "cpu") -> Any:
    """Return a phantom: the one given, or the shared one of a configuration (baked once)."""
    from racines_data.phantom import PhantomConfig, shared_phantom

    if phantom is None or isinstance(phantom, PhantomConfig):
        return shared_phantom(phantom or PhantomConfig(), str(device))
    if isinstance(phantom, (str, Path)) or not hasattr(phantom, "truth"):
        raise RacinesError(f"phantom {phantom!r} is neither a Phantom nor a PhantomConfig")
    return phantom
