"""Commands in processes that need not import torch first: forked from one that has.

A test process starts one server, which imports the libraries and starts no threads; each command
is a fork of it. What a command cannot tell from a fresh process: that its imports were quick.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable
from contextlib import chdir
from functools import cache
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext
from pathlib import Path
from subprocess import CompletedProcess
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any


class _Process(multiprocessing.get_context("forkserver").Process):
    """A fork with the environment of who starts it: the server has that of its own start."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._environment = dict(os.environ)

    def run(self) -> None:
        os.environ.clear()
        os.environ.update(self._environment)
        super().run()


class _Context(ForkServerContext):
    Process = _Process


_context = _Context()
_context.set_forkserver_preload(["tests.preloaded"])


@cache
def start() -> None:
    """Start the server where the module that it imports first is found, from wherever tests are."""
    with chdir(Path(__file__).parents[1]):
        forkserver.ensure_running()


def get_context(method: str | None = None) -> ForkServerContext:
    """Stand in for `multiprocessing.get_context`: workers are such forks, however asked for."""
    start()
    return _context


PLAIN = "RACINES_TEST_PLAIN_PICTURES"
"""Set in a command's environment, it leaves the pictures of a dataset's card blank."""


def plain_pictures(patch: Callable[[object, str, object], None] = setattr) -> None:
    """Put a small blank picture in place of each that a dataset's card or a grader's report has."""
    from PIL import Image

    from racines_data.card import pictures
    from racines_data.files import image_bytes
    from racines_models.judges.grader import evaluation

    blank = image_bytes(Image.new("L", (8, 8)))
    patch(pictures, "draw", lambda name, figure: blank)
    patch(evaluation, "encode", lambda figure: blank)


def run(folder: Path, words: tuple[str, ...], environment: dict[str, str]) -> CompletedProcess[str]:
    """Run `racines …` or `python -c …` in a folder; return what a subprocess would."""
    with TemporaryDirectory() as aside:
        out, err = Path(aside) / "out", Path(aside) / "err"
        process = get_context().Process(target=_child, args=(folder, words, environment, out, err))
        process.start()
        process.join()
        assert process.exitcode is not None
        return CompletedProcess(words, process.exitcode, out.read_text(), err.read_text())


def _child(
    folder: Path, words: tuple[str, ...], environment: dict[str, str], out: Path, err: Path
) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for stream, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    streams = [open(at, "w", encoding="utf-8", closefd=False) for at in (1, 2)]  # noqa: SIM115
    sys.stdout, sys.stderr = streams
    sys.argv = list(words) if words[0] == "racines" else ["-c", *words[3:]]
    if environment.get(PLAIN):
        plain_pictures()
    if words[0] == "racines":
        from racines_leaderboard.cli.command import main as racines

        racines()
    else:
        sys.path.insert(0, "")
        main = sys.modules["__main__"] = ModuleType("__main__")
        exec(compile(words[2], "<string>", "exec"), vars(main))
