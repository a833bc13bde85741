"""The child that runs a stranger's file: first its limits, then the file, one message at a time.

It is given the file's bytes, never its path; once the libraries are loaded it can open no file, no
socket and no process. Standard input and output are the wire; what libraries print is lost.
"""

import contextlib
import ctypes
import json
import resource
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from racines_leaderboard.submissions.confined import wire

MAX_TEXT = 500
Run = Callable[[bytes], bytes]


def main() -> None:
    """Serve the mode and the limits that the command line names, until the wire closes."""
    mode, limits = sys.argv[1], json.loads(sys.argv[2])
    _bound(resource.RLIMIT_AS, limits["memory"])
    _bound(resource.RLIMIT_CORE, 0)
    _bound(resource.RLIMIT_FSIZE, 0)
    _bound(resource.RLIMIT_CPU, limits["cpu_seconds"])
    asked, answers = Connection(0, writable=False), Connection(1, readable=False)
    try:
        opened = MODES[mode]()
        _close_the_doors()
    except Exception as error:
        wire.say(answers, wire.REFUSED, _text(error))
        return
    run: Run | None = None
    while True:
        try:
            kind, payload = wire.hear(asked)
        except EOFError:
            return
        _allow_seconds(limits["open_seconds" if kind == wire.OPEN else "call_seconds"])
        try:
            if kind == wire.OPEN:
                run = opened(payload)
                wire.say(answers, wire.ANSWER)
            elif run is not None:
                wire.say(answers, wire.ANSWER, run(payload))
        except BaseException as error:
            wire.say(answers, wire.REFUSED, _text(error))
            return


def _bound(what: int, limit: int) -> None:
    resource.setrlimit(what, (limit, limit))


def _close_the_doors() -> None:
    """Forbid further files, sockets, processes and privileges; the libraries are loaded by now."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)  # PR_SET_NO_NEW_PRIVS, Linux
    with contextlib.suppress(OSError, ValueError):
        _bound(resource.RLIMIT_NPROC, 0)
    _bound(resource.RLIMIT_NOFILE, 3)


def _allow_seconds(seconds: int) -> None:
    """Let this call take so much of the CPU, beyond what was taken; the whole stays bounded."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    whole = resource.getrlimit(resource.RLIMIT_CPU)[1]
    soft = min(int(used.ru_utime + used.ru_stime) + 1 + seconds, whole)
    resource.setrlimit(resource.RLIMIT_CPU, (soft, whole))


def _text(error: BaseException) -> bytes:
    short = isinstance(error, MemoryError) or "alloc" in str(error)
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return (b"M" if short else b"E") + text[:MAX_TEXT].encode(errors="replace")


def _session() -> Callable[[bytes], Run]:
    """Run a graph: inputs in, all outputs back."""
    import onnxruntime

    from racines_models.exchange.onnx.file import open_session

    onnxruntime.get_available_providers()

    def opened(content: bytes) -> Run:
        session = open_session(content, "the file", "cpu")
        names = [output.name for output in session.get_outputs()]

        def run(payload: bytes) -> bytes:
            outputs: list[Any] = list(session.run(names, wire.unpack_arrays(payload)))
            return wire.pack_arrays(dict(zip(names, outputs, strict=True)))

        return run

    return opened


def _parse_onnx() -> Callable[[bytes], Run]:
    """Parse and check a graph; nothing of it is run."""
    import onnx

    def opened(content: bytes) -> Run:
        model = onnx.load_model_from_string(content)
        onnx.checker.check_model(model)
        return bytes

    return opened


def _parse_parquet() -> Callable[[bytes], Run]:
    """Unpack every page of a predictions file, as its reader does."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_memory_pool(pa.system_memory_pool())

    def opened(content: bytes) -> Run:
        file = pq.ParquetFile(pa.BufferReader(content), read_dictionary=["image"], pre_buffer=False)
        for _ in file.iter_batches(64, use_threads=False):
            pass
        return bytes

    return opened


MODES = {"session": _session, "onnx": _parse_onnx, "parquet": _parse_parquet}

if __name__ == "__main__":
    main()
