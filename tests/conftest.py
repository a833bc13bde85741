"""What all tests share: one thread a process, the command, and one tiny dataset for all of them."""

import fcntl
import gc
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from tests import warm

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("MPLBACKEND", "agg")

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent
TINY = {
    "board": "tiny",
    "seed": 0,
    "data": {"frames": 240, "workers": 1, "phantom": {"shortest": 10, "longest": 20}},
    "grader": {"input_size": 32, "view_stage": {"epochs": 1}, "grade_stage": {"epochs": 1}},
    # The weights as they train, without their average: sixteen steps then draw what can be scored.
    "generators": {
        "vae-gan": {
            "width": 4,
            "learning_rate": 0.01,
            "training": {"images": 128, "batch_size": 8, "ema": 0.0},
        }
    },
    "scores": {"samples": 16, "resamples": 20, "speed": False},
    "agents": {"ppo": {"frames": 8192}},
    "evaluation": {"starts": 4},
}
"""Settings with which every command ends within seconds; its figures mean nothing."""


text_of = cache(Path.read_text)
Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage meanwhile: what tests import stays, and is much to look through."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the contracts' tests of rows, also the inherited ones, by their name.

    Files with slow tests come first, so that no process ends with one while the other is idle.
    """
    for item in items:
        if "ignores_its_batch" in item.name:
            item.add_marker("contract")
        for mark in ("docs", "instruction_sets"):
            if item.get_closest_marker(mark) and f"mark.{mark}" not in text_of(item.path):
                raise pytest.UsageError(f"{item.nodeid}: the Makefile looks for mark.{mark} here")
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish() -> None:
    """Keep what was imported out of every later collection of garbage, and of forks' memory."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def plain_pictures() -> Iterator[Callable[..., bytes | None]]:
    """Leave pictures of cards and graders blank, most of what they cost; give the cards' way."""
    from racines_data.card import pictures

    draw = pictures.draw
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(warm.PLAIN, "1")
        warm.plain_pictures(patch.setattr)
        yield draw


@pytest.fixture(scope="session", autouse=True)
def commands_built_once() -> Iterator[None]:
    """Let typer make the tree of all commands once, not at every call of one."""
    make, made = typer.main.get_command, {}

    def get_command(app: typer.Typer) -> Any:
        parts = (app, *app.registered_commands, *app.registered_groups)
        key = tuple(map(id, parts))
        if key not in made:
            made[key] = parts, make(app)  # held, so that their ids stay their own
        return made[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.main.get_command", get_command)
        patch.setattr("typer.testing._get_command", get_command)
        yield


@pytest.fixture(scope="module")
def drawn_pictures(plain_pictures: Callable[..., bytes | None]) -> Iterator[None]:
    """Draw the pictures of cards and of graders, as users have them."""
    from racines_data.plotting import encode

    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(warm.PLAIN)
        patch.setattr("racines_models.judges.grader.evaluation.encode", encode)
        patch.setattr("racines_data.card.pictures.draw", plain_pictures)
        yield


@pytest.fixture(scope="module")
def warm_workers() -> Iterator[None]:
    """Let workers be forks with their imports done, where how they start is beside the point."""
    from racines_data.engines import local
    from racines_models.training import processes

    warm.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local, "multiprocessing", warm)
        forked = partial(processes.start_processes, start_method="forkserver")
        patch.setattr(processes, "start_processes", forked)
        yield


def command(
    folder: Path, *words: str, code: int = 0, fresh: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder with this environment's programs first; check its exit code.

    Ours run in a process whose imports are done already, unless it has to be a `fresh` one.
    """
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "200"}
    if not fresh and (words[0] == "racines" or words[:2] == ("python", "-c")):
        done = warm.run(folder, words, environment)
    else:
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Once:
    """Make a folder by its name once for all test processes: `made_once(name, make)`."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent

    def once(name: str, make: Callable[[Path], object]) -> Path:
        folder = shared / name
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (shared / f"{name}.made").exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                (shared / f"{name}.made").touch()
        return folder

    return once


@pytest.fixture(scope="session")
def tiny_root(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A dataset of a few hundred phantom frames, built once for all test processes."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "tiny"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "racines").exists():
            (folder / "params.yaml").write_text(yaml.safe_dump(TINY))
            command(folder, "racines", "data", "build", "--out", "racines")
    return folder / "racines"


@pytest.fixture
def workplace(tmp_path: Path, tiny_root: Path) -> Path:
    """A folder that looks like the repository's root after the data stage, at a tiny size."""
    return lay_workplace(tmp_path, tiny_root)


def lay_workplace(folder: Path, data: Path) -> Path:
    """Make a folder look like the repository's root after the data stage, at a tiny size."""
    (folder / "data").mkdir()
    (folder / "data" / "racines").symlink_to(data)
    (folder / "racines").symlink_to("data/racines")
    (folder / "params.yaml").write_text(yaml.safe_dump(TINY))
    return folder


@pytest.fixture(scope="session")
def hearts(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A cache in which hearts are baked once for all test processes, by the code under test."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "hearts"
    folder.mkdir(exist_ok=True)
    return folder
