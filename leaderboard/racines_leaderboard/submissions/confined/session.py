"""A stranger's file in a child process with limits of time, memory and everything else.

The parent sends bytes and gets bytes back (`confined_wire`); it unpickles nothing. What breaks a
limit ends in a `RacinesError` that names the file and the limit, and the child is killed.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import racines_data
import racines_leaderboard
import racines_models
from racines_data.errors import RacinesError
from racines_leaderboard.submissions.confined import wire

START = (
    "import sys; sys.path[:0] = sys.argv.pop(1).split('|'); "
    "from racines_leaderboard.submissions.confined.child import main; main()"
)


@dataclass(frozen=True)
class Limits:
    """What a child may take."""

    memory: int = 4 * 2**30
    """Bytes of address space, libraries included (0.4 GiB)."""
    open_seconds: int = 120
    """To start and to open the file, by the wall clock and of the CPU."""
    call_seconds: int = 60
    """Of one call, likewise."""
    cpu_seconds: int = 4 * 3600
    """Of the CPU in all."""
    answer: int = 64 * 2**20
    """Bytes of one answer."""


class Child:
    """One process that serves one file; ends with this object, or when a limit is broken."""

    def __init__(self, mode: str, content: bytes, where: str, limits: Limits | None = None):
        """Start it and hand it the file.

        Args:
            mode: One of `confined_child.MODES`.
            content: The file.
            where: Its name, for errors.
            limits: The defaults by default.

        Raises:
            RacinesError: the file is refused, or broke a limit.
        """
        self.where, self.limits = where, limits or Limits()
        packages = (racines_data, racines_models, racines_leaderboard)
        roots = "|".join(str(Path(str(p.__file__)).resolve().parents[1]) for p in packages)
        # -I: neither the environment nor the current folder says what is imported.
        words = [sys.executable, "-I", "-c", START, roots, mode, json.dumps(asdict(self.limits))]
        self._process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd="/",
            env=_environment(),
            start_new_session=True,
        )
        self._end = weakref.finalize(self, _kill, self._process)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            os.set_blocking(pipe.fileno(), False)
        self.ask(wire.OPEN, content)

    def ask(self, kind: int, payload: bytes) -> bytes:
        """Send a message and return the answer's payload.

        Raises:
            RacinesError: refused, or a limit was broken; the child is gone then.
        """
        seconds = self.limits.open_seconds if kind == wire.OPEN else self.limits.call_seconds
        deadline = time.monotonic() + seconds
        try:
            with contextlib.suppress(BrokenPipeError):  # its last words say why
                self._send(wire.frame(kind, payload), deadline)
            kind, length = wire.frame_head(self._take(wire.HEAD.size, deadline), self.limits.answer)
            answer = self._take(length, deadline)
        except wire.WireError as error:
            self.close()
            raise RacinesError(f"{self.where}: refused: {error}") from error
        except TimeoutError as error:
            self.close()
            raise RacinesError(f"{self.where}: took more than {seconds} s: stopped") from error
        except EOFError as error:
            raise RacinesError(f"{self.where}: {self._cause_of_death(seconds)}") from error
        except BaseException:
            self.close()
            raise
        if kind != wire.ANSWER:
            self.close()
            raise RacinesError(f"{self.where}: {self._told(answer)}")
        return answer

    def close(self) -> None:
        """Kill the child, if it still runs."""
        self._end()

    def _send(self, data: bytes, deadline: float) -> None:
        assert self._process.stdin is not None
        handle, left = self._process.stdin.fileno(), memoryview(data)
        while left:
            _wait([], [handle], deadline)
            left = left[os.write(handle, left[: 2**20]) :]

    def _take(self, count: int, deadline: float) -> bytes:
        assert self._process.stdout is not None
        handle, parts = self._process.stdout.fileno(), []
        while count:
            _wait([handle], [], deadline)
            part = os.read(handle, min(count, 2**20))
            if not part:
                raise EOFError
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def _cause_of_death(self, seconds: int) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(5)
        code = self._process.returncode
        self.close()
        if code == -signal.SIGXCPU:
            return f"took more than {seconds} s of the CPU: stopped"
        name = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
        return f"its process died ({name}); {self._memory()}"

    def _told(self, answer: bytes) -> str:
        text = "".join(c if c.isprintable() else " " for c in answer[1:].decode(errors="replace"))
        return f"{text[:500]}; {self._memory()}" if answer[:1] == b"M" else f"refused: {text[:500]}"

    def _memory(self) -> str:
        return f"the memory limit is {self.limits.memory / 2**20:,.0f} MiB"


def _environment() -> dict[str, str]:
    """Return what a child sees of this process's environment: where libraries lie, no secret."""
    kept = {name: os.environ[name] for name in ("LD_LIBRARY_PATH",) if name in os.environ}
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _wait(read: Sequence[int], write: Sequence[int], deadline: float) -> None:
    ready = select.select(read, write, [], max(0.0, deadline - time.monotonic()))
    if not (ready[0] or ready[1]):
        raise TimeoutError


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a child with all that it may have started, and collect it."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()


class ConfinedSession:
    """Looks like the onnxruntime session of a file, and runs it in a child."""

    def __init__(
        self, content: bytes, where: str, device: str = "cpu", limits: Limits | None = None
    ):
        """Open the file's bytes; the device is the CPU whatever is named."""
        self._child = Child("session", content, where, limits)

    def get_providers(self) -> list[str]:
        """Return what runs the graph."""
        return ["CPUExecutionProvider"]

    def run(self, names: Sequence[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Return the named outputs.

        Raises:
            RacinesError: the graph failed, or broke a limit.
        """
        answer = self._child.ask(wire.RUN, wire.pack_arrays(inputs))
        try:
            outputs = wire.unpack_arrays(answer)
            return [outputs[name] for name in names]
        except (wire.WireError, KeyError) as error:
            self._child.close()
            raise RacinesError(f"{self._child.where}: refused: {error}") from error


def rehearse(kind: str, content: bytes, where: str, limits: Limits | None = None) -> None:
    """Parse a file in a child first, so that this process parses only what parses within limits.

    Args:
        kind: `onnx` or `parquet`.
        content: The file.
        where: Its name, for errors.
        limits: The defaults by default.

    Raises:
        RacinesError: the parser refuses it, or it broke a limit.
    """
    Child(kind, content, where, limits).close()
