"""Tests of a mutant in a fork of one process that has imported all libraries, and nothing of ours.

    parent: torch, pytest, … ──fork──> child: the changed text in the module's place, pytest

The child's first import of the module gets the changed text, and so does all that imports it.
"""

import contextlib
import importlib
import importlib.abc
import importlib.util
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import CodeType
from typing import Any

from tests.mutants.catalogue import ROOT

PRELOAD = """
    accelerate datasets gymnasium huggingface_hub matplotlib.figure matplotlib.pyplot
    monai.networks.nets.resnet numpy pandas PIL.Image polars pyarrow.parquet pytest pytest_timeout
    rich.progress safetensors.torch scipy.linalg scipy.ndimage scipy.optimize scipy.stats
    skimage.metrics tensordict.nn torch torch.distributions torch.optim.swa_utils
    torchmetrics.functional.classification
    torchmetrics.functional.image torchmetrics.image.kid torchrl.collectors torchrl.data
    torchrl.envs torchrl.modules torchrl.objectives.value typer.testing xdist.plugin yaml
"""
"""What a child need not import any more."""
OURS = ("racines_data", "racines_models", "racines_envs", "racines_leaderboard")
PACKAGES = ("models", "envs", "leaderboard")


@dataclass(frozen=True)
class Outcome:
    """What the tests said of a module's text."""

    verdict: str
    """`killed`, `survived`, `time-out` (which counts as killed), or `error`."""
    seconds: float
    by: str = ""
    """The first test that failed."""


def preload() -> None:
    """Import the libraries; ours must not be among what they import."""
    for name in PRELOAD.split():
        importlib.import_module(name)
    early = sorted(name for name in sys.modules if name.split(".")[0] in OURS)
    if early:
        raise RuntimeError(f"imported before the fork: {', '.join(early)}")


def module_name(file: str) -> str:
    """Return the name by which a file of the repository is imported."""
    parts = Path(file).with_suffix("").parts
    return ".".join(parts[1:] if parts[0] in PACKAGES else parts)


class Run:
    """A fork under way; `poll` it until it has an outcome."""

    def __init__(
        self, tests: Sequence[str], limit: float, file: str = "", source: str = ""
    ) -> None:
        self._aside = tempfile.TemporaryDirectory(prefix="mutant-")
        self._limit, self._began = limit, time.monotonic()
        context = multiprocessing.get_context("fork")
        where = Path(self._aside.name)
        self.process: BaseProcess = context.Process(
            target=_child, args=(where, tests, file, source)
        )
        self.process.start()

    def poll(self) -> Outcome | None:
        """Return the outcome if there is one; end what has run for too long."""
        seconds = time.monotonic() - self._began
        if self.process.is_alive() and seconds < self._limit:
            return None
        late = self.process.is_alive()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid or 0, signal.SIGKILL)  # and what it has started
        self.process.join()
        failed = Path(self._aside.name) / "failed"
        by = failed.read_text() if failed.exists() else ""
        if not by and self.process.exitcode not in (0, 1):
            by = (Path(self._aside.name) / "output").read_text()[-2000:]
        self._aside.cleanup()
        return Outcome("time-out" if late else _verdict(self.process.exitcode), seconds, by)


def _verdict(code: int | None) -> str:
    # pytest: 0 passed, 1 failed, 2 not collected; below zero a signal. 3-5 are the runner's fault.
    if code == 0:
        return "survived"
    return "killed" if code in (1, 2) or (code or 0) < 0 else "error"


def _child(aside: Path, tests: Sequence[str], file: str, source: str) -> None:
    os.setsid()
    output = os.open(aside / "output", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.chdir(ROOT)
    if file:
        sys.meta_path.insert(0, _Finder(file, source))
    import pytest

    # Of the plug-ins only those that our tests use: the others' imports outlast most tests.
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    plugins = ["-p", "no:cacheprovider", "-p", "xdist.plugin", "-p", "pytest_timeout"]
    words = ["-x", "-q", "-n", "0", *plugins, f"--basetemp={aside / 'tmp'}"]
    code = pytest.main([*words, *tests], plugins=[_Recorder(aside / "failed")])
    sys.stdout.flush()
    os._exit(int(code))


class _Recorder:
    """Writes down the first test that fails."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and not self._path.exists():
            self._path.write_text(report.nodeid)

    pytest_collectreport = pytest_runtest_logreport


class _Finder(importlib.abc.MetaPathFinder):
    """Finds one module, with the text given."""

    def __init__(self, file: str, source: str) -> None:
        self._name, self._path, self._source = module_name(file), str(ROOT / file), source

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        loader = _Loader(fullname, self._path)
        loader.text = self._source
        return importlib.util.spec_from_file_location(fullname, self._path, loader=loader)


class _Loader(SourceFileLoader):
    text = ""

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.text, self.path, "exec", dont_inherit=True)
