"""From names to a core: what `gymnasium.make`, `ScanEnv` and the evaluation all call."""

import dataclasses
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.phantom.anatomy import anatomy_views
from racines_data.views import HEART, labels_of
from racines_envs.backends import GRADER_FOLDER, make_backend, make_grader
from racines_envs.core import ScanCore
from racines_envs.rewards import RewardConfig
from racines_envs.sensing import Encoder
from racines_envs.tasks import Task, get_task


def make_core(
    view: str | Task,
    num_envs: int = 1,
    *,
    backend: str | ImageSource = "phantom",
    observation: str = "image",
    reward: str = "paper",
    phantom: Any = None,
    anatomy: str | None = None,
    generator: Any = None,
    grader: Any = None,
    termination: str | None = None,
    rewards: RewardConfig | None = None,
    device: torch.device | str = "cpu",
    encoder: Encoder | None = None,
) -> ScanCore:
    """Build the batched core of a task.

    Args:
        view: A target view of the phantom's anatomy, a task's name, or a task of your own.
        num_envs: Rows.
        backend: `phantom`, `generator`, or an object that makes images of parameters.
        observation: `image`, `params` or `multimodal`.
        reward: `paper` (by the grader), `oracle` (the same by the phantom's truth) or `shaped`.
        phantom: A phantom or its configuration; the shared one of the anatomy by default.
        anatomy: Whose view it is; the phantom's anatomy by default, or else the heart.
        generator: Name, run folder or object, for the backend `generator`.
        grader: Run folder or object; models/runs/grader for reward `paper`.
        termination: Instead of the task's: `first_hit`, `k_hits` or `timeout`.
        rewards: The numbers of the reward.
        device: Where the tensors live.
        encoder: A frozen network that the agent looks through; see `ScanCore`.

    Raises:
        RacinesError: any name that is unknown or any artefact that is not there.
    """
    task = find_task(view, phantom, anatomy)
    if termination is not None:
        task = dataclasses.replace(task, termination=termination)
    if reward == "paper" and grader is None:
        grader = GRADER_FOLDER
    if grader is not None:
        grader = make_grader(grader, device)
        check_grader(grader, task)
    phantom = make_phantom(phantom, device, task.anatomy)
    images = make_backend(backend, phantom, generator, device)
    return ScanCore(
        task, phantom, images, grader, observation, reward, rewards, num_envs, device, encoder
    )


def find_task(view: str | Task, phantom: Any = None, anatomy: str | None = None) -> Task:
    """Return the task of a view: of an anatomy, or else of that of a phantom or its configuration.

    Raises:
        RacinesError: no such view, or a task of another anatomy than the phantom's.
    """
    config = getattr(phantom, "config", phantom)
    held = getattr(config, "anatomy", None)
    task = view if isinstance(view, Task) else get_task(view, anatomy or held or HEART)
    if held not in (None, task.anatomy):
        raise RacinesError(
            f"task {task.id} is the {task.anatomy}'s and the phantom holds the {held}: give "
            f"phantom=PhantomConfig(anatomy={task.anatomy!r})"
        )
    return task


def check_grader(grader: Any, task: Task) -> None:
    """Check that a grader knows the views of a task's anatomy, if it says which it knows.

    Raises:
        RacinesError: it was trained for other views.
    """
    if hasattr(grader, "check_labels"):
        grader.check_labels(labels_of(anatomy_views(task.anatomy)), f"the {task.anatomy}")


def make_phantom(phantom: Any, device: torch.device | str = "cpu", anatomy: str = HEART) -> Any:
    """Return a phantom: the one given, or the shared one of a configuration (baked once)."""
    from racines_data.phantom import PhantomConfig, shared_phantom

    if phantom is None or isinstance(phantom, PhantomConfig):
        return shared_phantom(phantom or PhantomConfig(anatomy=anatomy), str(device))
    if isinstance(phantom, (str, Path)) or not hasattr(phantom, "truth"):
        raise RacinesError(f"phantom {phantom!r} is neither a Phantom nor a PhantomConfig")
    return phantom


def phantom_recipe(phantom: Any) -> dict[str, Any] | None:
    """Return the version and configuration digest of a phantom; None for a stand-in."""
    from racines_data.digest import recipe_digest
    from racines_data.phantom import PHANTOM_VERSION

    if not hasattr(phantom, "config"):
        return None
    recipe = {"version": PHANTOM_VERSION, "config": dataclasses.asdict(phantom.config)}
    return {"version": PHANTOM_VERSION, "recipe_digest": recipe_digest(recipe)}
