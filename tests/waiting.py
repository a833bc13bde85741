"""Waiting for what is to happen, however slow the machine is.

A deadline here only turns a hang into a failure: no test passes or fails by the clock.
"""

import subprocess
import threading
import time
from collections.abc import Callable, Sequence

import psutil

PATIENCE = 600.0
"""Seconds after which what did not happen is taken for a hang."""


def until(happened: Callable[[], object], process: subprocess.Popen | None = None) -> None:
    """Return once something has happened; fail if the process that is to do it ends first."""
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert process is None or process.poll() is None, "the process ended too early"
        assert time.monotonic() < deadline, f"did not happen within {PATIENCE:g} s"
        time.sleep(0.02)


def halt() -> None:
    """Stand still until the process is killed: what is to die here cannot finish first."""
    threading.Event().wait()


def descendants(process: subprocess.Popen) -> list[psutil.Process]:
    """Return the processes that a running one has started, and those that they have."""
    return psutil.Process(process.pid).children(recursive=True)


def until_ended(processes: Sequence[psutil.Process]) -> None:
    """Return once all of them have ended; kill those that do not, and fail."""
    try:
        until(lambda: not any(map(_runs, processes)))
    finally:
        for process in filter(_runs, processes):
            process.kill()


def _runs(process: psutil.Process) -> bool:
    try:  # an orphan that ended stays a zombie where nobody collects it
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
