"""Backends: what draws the images of an environment. Each is an `ImageSource`.

The environment never knows which it has. A backend may also have `wrench(pose)`, which is then felt
instead of the phantom's contact, and `out_of_support(parameters)`, which the info then tells.
"""

import json
from pathlib import Path

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.imaging import ImageSource
from racines_data.randomness import sample_seeds
from racines_data.views import HEART
from racines_data.world import World
from racines_envs.task.names import HEART_TIER, PATIENTS
from racines_envs.task.tasks import Task
from racines_models.protocol import Judge
from racines_models.published.places import WEIGHTS, own_or_published

GRADER_FOLDER = Path("models/runs/grader")
GRADERS = {
    HEART_TIER: (GRADER_FOLDER, (WEIGHTS / "grader", WEIGHTS / "student")),
    PATIENTS: (Path("models/runs/grader-patients"), (WEIGHTS / "phantom-patients/grader",)),
}
"""Where the grader of a tier lies: one trained here stands before the published ones. The student
does where it alone is, in an installed package."""
GRADER_FILE = "grader.safetensors"
JudgeLike = Judge | Path | str | None  # a grader itself, its run folder, or None for the default
BACKENDS = ("phantom", "generator", "replay")


class PhantomImages:
    """A world's own images: no check of the parameters, which would wait for the device."""

    def __init__(self, phantom: World) -> None:
        self.phantom = phantom

    def of(self, scene: World) -> "PhantomImages":
        """Return the images of a scene of the world."""
        return self if scene is self.phantom else PhantomImages(scene)

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of (B, 12) parameters that are known to be good."""
        seeds = sample_seeds(seed, len(parameters), parameters.device)
        return self.phantom.render(parameters_to_pose(parameters), seeds)


def open_source(spec: str | Path, device: torch.device | str = "cpu") -> ImageSource:
    """Return the generator that a spec names, whichever way it comes.

    A spec is a registered name or `module:Class` (its run in models/runs/NAME), either with
    `@FOLDER` for a run elsewhere; the folder of a run, which says whose it is; or `FILE.onnx`.
    What is unknown, absent or refused is said by name or file.
    """
    from racines_models.registry import is_file, open_generator

    name, _, folder = str(spec).partition("@")
    if is_file(name):
        return open_generator(name, folder or None, str(device))
    if not folder and Path(name).is_dir():
        return open_generator(_whose(Path(name)), name, str(device))
    if "/" in name:
        raise RacinesError(f"generator {name!r}: no run folder or file of that name")
    run = _run(name, folder)
    if not run.is_dir():
        raise RacinesError(
            f"generator {name!r}: no run folder {run}; run `racines train generator {name}`"
        )
    return open_generator(name, run, str(device))


def source_weights(spec: str | Path) -> dict[str, str]:
    """Return the SHA-256 of each weights file of the generator that a spec names, by file name."""
    from racines_models.provenance import weights_sha256
    from racines_models.registry import is_file, weights_of

    name, _, folder = str(spec).partition("@")
    place = Path(folder or name)
    if is_file(name) or place.is_dir():
        return weights_sha256(place) if place.is_dir() else weights_of(name)
    return weights_of(name, _run(name, folder))


def _run(name: str, folder: str) -> Path:
    """Return the folder given, or that of a run made here, or else of the published weights."""
    from racines_models.published.places import WEIGHTS, own_or_published
    from racines_models.registry import run_folder

    run = run_folder(name, folder or None)
    return run if folder else own_or_published(run, WEIGHTS / run.name, "config.json")


def _whose(folder: Path) -> str:
    """Return the name of the generator that a run folder holds."""
    path = folder / "config.json"
    if not path.is_file():
        raise RacinesError(f"{folder}: no trained generator here (config.json); train one there")
    try:
        return json.loads(path.read_text(encoding="utf-8"))["name"]
    except (ValueError, KeyError, TypeError) as error:
        raise RacinesError(f"{path}: names no generator ({error}); train it again") from error


def make_backend(
    backend: str | ImageSource, phantom: World, generator: ImageSource | str | Path | None,
    device: torch.device | str,
) -> ImageSource:  # fmt: skip
    """Return the source of images: that of `phantom` or `generator` (recordings are open by now).

    An object that satisfies `ImageSource` is taken as it is; so is a generator, which else is what
    `open_source` opens.
    """
    if not isinstance(backend, str):
        if not isinstance(backend, ImageSource):
            raise RacinesError(f"backend {backend!r} has no generate(parameters, seed)")
        return backend
    if backend not in BACKENDS:
        raise RacinesError(f"unknown backend {backend!r}: choose one of {', '.join(BACKENDS)}")
    if backend == "phantom":
        return PhantomImages(phantom)
    if generator is None:
        raise RacinesError(
            "backend 'generator' needs one: give generator=<name, run folder, module:Class, "
            "FILE.onnx or object>"
        )
    return generator if isinstance(generator, ImageSource) else open_source(generator, device)


def usual_grader(task: Task) -> Path:
    """Return the folder of the grader that is meant where none is named: that of the task's tier.

    One trained in the current folder, or else the published one, which is said once. Beating hearts
    have that of patients; an organ only one that was trained here.
    """
    if task.anatomy != HEART:
        return GRADER_FOLDER
    own, folders = GRADERS[HEART_TIER if task.tier == HEART_TIER else PATIENTS]
    return own_or_published(own, folders, GRADER_FILE)


def make_grader(
    grader: Judge | Path | str, device: torch.device | str, task: Task | None = None
) -> Judge:
    """Load the grader that was trained in a run folder, or take a `Judge`, that knows a task."""
    if not isinstance(grader, Judge):
        if not isinstance(grader, (str, Path)):
            raise RacinesError(f"grader {grader!r}: inherit from racines_models.protocol.Judge")
        folder, (_, heart) = Path(grader), GRADERS[HEART_TIER]
        if folder in heart:  # as profiles name it: elsewhere, or the student in its place
            folder = own_or_published(folder, heart, GRADER_FILE)
        if not (folder / GRADER_FILE).is_file():
            out = "" if folder == GRADER_FOLDER else f" --out {folder}"
            raise RacinesError(
                f"{folder}: no trained grader ({GRADER_FILE}): run `racines train grader{out}`, "
                "or do without one: reward='oracle'"
            )
        from racines_models.judges.grader.model import Grader

        grader = Grader.load(folder, str(device))
    if task is not None:
        check_grader(grader, task)
    return grader


def check_grader(grader: Judge | None, task: Task) -> None:
    """Check that a grader, if there is one, knows the views of a task's anatomy."""
    if grader is not None:
        grader.check_labels(task.labels, f"the {task.anatomy}")
