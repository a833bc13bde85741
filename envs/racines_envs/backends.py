"""Backends: what draws the images of an environment. Each is an `ImageSource` and nothing more.

The environment never knows which it has: contact and truth always come from the phantom.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.imaging import ImageSource
from racines_data.randomness import sample_seeds

GRADER_FOLDER = Path("models/runs/grader")
GENERATOR_FOLDER = Path("models/runs")


class PhantomImages:
    """The phantom without its check of the parameters, which would wait for the device."""

    def __init__(self, phantom: Any) -> None:
        self.phantom = phantom

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of (B, 12) parameters that are known to be good."""
        seeds = sample_seeds(seed, len(parameters), parameters.device)
        return self.phantom.render(parameters_to_pose(parameters), seeds)


def _phantom(phantom: Any, generator: Any, device: torch.device | str) -> ImageSource:
    return PhantomImages(phantom)


def _generator(phantom: Any, generator: Any, device: torch.device | str) -> ImageSource:
    """Load a generator by name (from models/runs/<name>) or run folder, or take an object."""
    if generator is None:
        raise RacinesError(
            "backend 'generator' needs one: give generator=<name, run folder or object>"
        )
    if isinstance(generator, ImageSource):
        return generator
    folder = Path(generator)
    if not folder.is_dir():
        folder = GENERATOR_FOLDER / str(generator)
    if not folder.is_dir():
        raise RacinesError(
            f"generator {str(generator)!r}: no run folder {folder}; run "
            f"`racines train generator {generator}`"
        )
    from racines_models.registry import load_generator

    return load_generator(folder.name, folder, str(device))


BACKENDS: dict[str, Callable[[Any, Any, torch.device | str], ImageSource]] = {
    "phantom": _phantom,
    "generator": _generator,
}
"""By name: (phantom, generator, device) -> ImageSource."""


def make_backend(
    backend: str | ImageSource, phantom: Any, generator: Any, device: torch.device | str
) -> ImageSource:
    """Return the source of images; an object that satisfies `ImageSource` is taken as it is.

    Raises:
        RacinesError: an unknown backend, or a generator that is not there.
    """
    if not isinstance(backend, str):
        if not isinstance(backend, ImageSource):
            raise RacinesError(f"backend {backend!r} has no generate(parameters, seed)")
        return backend
    if backend not in BACKENDS:
        raise RacinesError(f"unknown backend {backend!r}: choose one of {', '.join(BACKENDS)}")
    return BACKENDS[backend](phantom, generator, device)


def make_grader(grader: Any, device: torch.device | str) -> Any:
    """Load the grader from its run folder, or take an object.

    Raises:
        RacinesError: no grader has been trained there.
    """
    if hasattr(grader, "probabilities_and_grade"):
        return grader
    folder = Path(grader)
    if not (folder / "grader.safetensors").is_file():
        raise RacinesError(
            f"{folder}: no trained grader (grader.safetensors): run `racines train grader`, or do "
            "without one: reward='oracle'"
        )
    from racines_models.grader import Grader

    return Grader.load(folder, str(device))
