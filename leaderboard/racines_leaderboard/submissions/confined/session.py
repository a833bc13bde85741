"""A stranger's file in a child process with limits of time and memory, and nothing else to reach.

The parent sends bytes and gets bytes back (`child`); it unpickles nothing. What breaks a limit ends
in a `RacinesError` that names the file and the limit, and the child is killed.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.connection import Pipe
from pathlib import Path

import numpy as np

import racines_data
import racines_leaderboard
import racines_models
from racines_data.errors import RacinesError
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_leaderboard.submissions.confined import child as wire
from racines_leaderboard.submissions.document import MAX_BYTES, read_bounded
from racines_models.exchange.onnx.generator import OnnxGenerator

START = (
    "import sys; sys.path[:0] = sys.argv.pop(1).split('|'); "
    "from racines_leaderboard.submissions.confined.child import main; main()"
)
REMEDY = "run it on Linux (x86_64 or aarch64), or give --unconfined and trust its author"


@dataclass(frozen=True)
class Limits:
    """What a child may take."""

    memory: int = 4 * 2**30
    """Bytes of address space, libraries included (0.4 GiB)."""
    open_seconds: int = 120
    """To start, and again to open the file; by the wall clock and of the CPU."""
    call_seconds: int = 60
    """Of one call, likewise."""
    cpu_seconds: int = 4 * 3600
    """Of the CPU in all."""
    answer: int = 64 * 2**20
    """Bytes of one answer."""
    unconfined: bool = False
    """Go on with these limits alone where the kernel cannot confine; otherwise that is refused."""


class Child:
    """One process that serves one file; ends with this object, or when a limit is broken.

    It runs one of `child.MODES` on the content; errors call the file `where`.

    Raises:
        RacinesError: the file is refused, or broke a limit; so does `ask`, and the child is gone.
    """

    def __init__(self, mode: str, content: bytes, where: str, limits: Limits | None = None) -> None:
        self.where, self.limits = where, limits or Limits()
        check_platform(where, self.limits.unconfined)
        self._memory = f"the memory limit is {self.limits.memory / 2**20:,.0f} MiB"
        packages = (racines_data, racines_models, racines_leaderboard)
        roots = "|".join(str(Path(str(p.__file__)).resolve().parents[1]) for p in packages)
        # -I: neither the environment nor the current folder says what is imported.
        # A child ends with the thread that starts it: with that alone which ends with the process.
        main = threading.current_thread() is threading.main_thread()
        told = json.dumps(asdict(self.limits) | {"parent": os.getpid() if main else 0})
        words = [sys.executable, "-I", "-c", START, roots, mode, told]
        # Of this process's environment it sees where libraries lie, and no secret.
        seen = {key: value for key, value in os.environ.items() if key == "LD_LIBRARY_PATH"}
        seen |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        asked, self._asks = Pipe(duplex=False)
        self._answers, answers = Pipe(duplex=False)
        with asked, answers:  # the child's ends
            self._process = subprocess.Popen(
                words,
                stdin=asked.fileno(),
                stdout=answers.fileno(),
                stderr=subprocess.DEVNULL,
                cwd="/",
                env=seen,
                start_new_session=True,
            )
        self._end = weakref.finalize(self, _stop, self._process, collect=True)
        # Until it says that it is confined it has nothing of the stranger's, and may be believed.
        self._ours = True
        self._exchange(self.limits.open_seconds, lambda: None)
        self._ours = False
        self.ask(wire.OPEN, content)

    def ask(self, kind: bytes, payload: bytes) -> bytes:
        """Send a message and return the answer's payload."""
        seconds = self.limits.open_seconds if kind == wire.OPEN else self.limits.call_seconds
        return self._exchange(seconds, lambda: wire.say(self._asks, kind, payload))

    def _exchange(self, seconds: int, say: Callable[[], None]) -> bytes:
        """Say something and return the payload of what the child says to it, in time."""
        self._allow_cpu(seconds)
        deadline = time.monotonic() + seconds
        # Whatever is waited for ends with the child: the pipes have no other holder.
        clock = threading.Timer(seconds, _stop, [self._process])
        clock.daemon = True
        clock.start()
        try:
            try:
                with contextlib.suppress(BrokenPipeError):  # its last words say why
                    say()
                kind, answer = wire.hear(self._answers, self.limits.answer)
            except (EOFError, OSError) as error:
                late = time.monotonic() >= deadline
                reason = f"took more than {seconds} s: stopped" if late else self._cause(seconds)
                raise RacinesError(f"{self.where}: {reason}") from error
            if kind != wire.ANSWER:
                raise RacinesError(f"{self.where}: {self._told(answer)}")
            return answer
        except BaseException:
            self.close()
            raise
        finally:
            clock.cancel()

    def close(self) -> None:
        """Kill the child, if it still runs."""
        self._end()
        self._asks.close()
        self._answers.close()

    def _allow_cpu(self, seconds: int) -> None:
        """Let this call take so much of the CPU; from here, for the child may set nothing.

        What still counts when this process is gone, and its clock with it.
        """
        if sys.platform != "linux":  # others have no prlimit(2)
            return
        import resource

        pid = self._process.pid
        with contextlib.suppress(OSError):  # the child is gone: the pipes will say so
            used = time.clock_gettime((~pid << 3) | 2)  # clock_getcpuclockid(3) of the process
            hard = resource.prlimit(pid, resource.RLIMIT_CPU)[1]
            whole = self.limits.cpu_seconds
            whole = whole if hard == resource.RLIM_INFINITY else min(whole, hard)
            soft = min(int(used) + 1 + seconds, whole)
            resource.prlimit(pid, resource.RLIMIT_CPU, (soft, whole))

    def _cause(self, seconds: int) -> str:
        """Say why there is no answer: no message came, or the child died."""
        if self._asks.closed:
            return "its process was stopped before"
        if self._answers.closed:
            return f"refused: what came is no message of at most {self.limits.answer:,} bytes"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(5)
        code = self._process.returncode
        if code is None:
            return "refused: it closed the wire"
        if code == -signal.SIGXCPU:
            return f"took more than {seconds} s of the CPU: stopped"
        name = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
        return f"its process died ({name}); {self._memory}"

    def _told(self, answer: bytes) -> str:
        text = "".join(c if c.isprintable() else " " for c in answer[1:].decode(errors="replace"))
        if self._ours and answer[:1] == b"K":
            return f"nothing here can confine what a stranger sent: {text[:500]}: {REMEDY}"
        return f"{text[:500]}; {self._memory}" if answer[:1] == b"M" else f"refused: {text[:500]}"


def _stop(process: subprocess.Popen[bytes], collect: bool = False) -> None:
    """Kill a child with all that it may have started."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    if collect:
        process.wait()


def check_platform(where: str, unconfined: bool) -> None:
    """Refuse a system that cannot hold a child: by name, before anything of a stranger's is read.

    Raises:
        RacinesError: Windows, which has no such limits; another that is not Linux, unless the
            caller goes on `unconfined`.
    """
    if sys.platform == "win32":
        raise RacinesError(
            f"{where}: Windows (win32) can neither confine a process nor limit what it takes: run "
            "it on Linux (x86_64 or aarch64), as WSL is one"
        )
    if sys.platform != "linux" and not unconfined:
        raise RacinesError(
            f"{where}: nothing here can confine what a stranger sent: {sys.platform} has no filter "
            f"here: {REMEDY}"
        )


class ConfinedSession:
    """Looks like the onnxruntime session of a file, and runs it in a child, always on the CPU."""

    def __init__(
        self, content: bytes, where: str, device: str = "cpu", limits: Limits | None = None
    ) -> None:
        self._child = Child("session", content, where, limits)

    def get_providers(self) -> list[str]:
        """Return what runs the graph."""
        return ["CPUExecutionProvider"]

    def run(self, names: Sequence[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Return the named outputs; RacinesError if the graph failed, or broke a limit."""
        answer = self._child.ask(wire.RUN, wire.pack_arrays(inputs))
        try:
            outputs = wire.unpack_arrays(answer)
            return [outputs[name] for name in names]
        except (wire.WireError, KeyError) as error:
            self._child.close()
            raise RacinesError(f"{self._child.where}: refused: {error}") from error


def rehearse(kind: str, content: bytes, where: str, limits: Limits | None = None) -> None:
    """Parse an `onnx` or `parquet` file in a child, before this process does, within limits."""
    Child(kind, content, where, limits).close()


class ConfinedGenerator(OnnxGenerator):
    """Draws what `OnnxGenerator` draws, byte for byte, on the CPU; RacinesError if it may not."""

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        super().__init__(path, "cpu", _confined(path, limits))


class ConfinedPolicyAgent(OnnxPolicyAgent):
    """Acts as `OnnxPolicyAgent` acts, on the CPU; RacinesError if it may not."""

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        super().__init__(path, "cpu", _confined(path, limits))


def _confined(path: Path, limits: Limits | None) -> Callable[..., ConfinedSession]:
    """Rehearse a file's parse; return what opens it."""
    content = read_bounded(path.parent, path.name, str(path.parent), MAX_BYTES)
    rehearse("onnx", content, str(path), limits)
    return partial(ConfinedSession, limits=limits)
