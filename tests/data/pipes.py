"""A FIFO in the place of a file, at which a test that fails does not hang."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def fifo(path: Path, seconds: float = 5) -> Iterator[Path]:
    """Put a FIFO in the place of a file; whoever opens it waits so long, and finds it empty.

    A time limit on the test would not do: a thread that waits at a FIFO cannot be interrupted.
    """
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    over = threading.Event()

    def release() -> None:
        while not over.wait(seconds):
            with suppress(OSError):  # nobody waits
                os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))

    waiting = threading.Thread(target=release, daemon=True)
    waiting.start()
    yield path
    over.set()
    waiting.join()
    path.unlink()
