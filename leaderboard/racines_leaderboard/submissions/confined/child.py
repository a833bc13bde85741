"""The child that runs a stranger's file: first its limits, then the file, one message at a time.

It is given the file's bytes, never its path; once the libraries are loaded it can open no file, no
socket and no process (`kernel`). Standard input and output are the wire; what libraries print is
lost.

Parent and child send bytes, never pickles. A message is its kind and its payload, two byte strings
of `multiprocessing.connection`, of which `send_bytes` and `recv_bytes` alone are used: its `send`
and `recv` would unpickle. Arrays are packed by safetensors, whose reader checks every length before
it takes the bytes.
"""

import contextlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from racines_leaderboard.submissions.confined.kernel import (
    CannotConfineError,
    confine,
    end_with,
    open_no_more,
)

MAX_TEXT = 500
MAX_HEADER = 2**20
"""Bytes that say which arrays an answer holds: some ten thousand of them."""
Run = Callable[[bytes], bytes]
OPEN, RUN, ANSWER, REFUSED = b"O", b"R", b"A", b"X"
"""Kinds: a file's bytes, inputs, outputs, and one line of text that says what is wrong."""
TYPES = (np.dtype("<f4"), np.dtype("u1"))


class WireError(Exception):
    """Bytes that are no message."""


def say(pipe: Connection, kind: bytes, payload: bytes = b"") -> None:
    """Send a message."""
    pipe.send_bytes(kind)
    pipe.send_bytes(payload)


def hear(pipe: Connection, limit: int | None = None) -> tuple[bytes, bytes]:
    """Return the kind and the payload of the next message.

    Raises:
        EOFError: the other side is gone.
        OSError: it went in the middle of a message; or, the pipe being closed then, what came is no
            message, or one of more than `limit` bytes.
    """
    return pipe.recv_bytes(1), pipe.recv_bytes(limit)


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return arrays as bytes; a WireError says that one is neither float32 nor uint8."""
    _check_types(arrays)
    return save({name: np.asarray(array, order="C") for name, array in arrays.items()})


def unpack_arrays(payload: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of `pack_arrays`; a WireError, where length or type does not fit."""
    if int.from_bytes(payload[:8], "little") > MAX_HEADER:
        raise WireError(f"arrays whose header takes more than {MAX_HEADER:,} bytes")
    try:
        arrays = load(payload)
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise WireError(f"arrays that do not fit their header: {error}") from error
    _check_types(arrays)
    return arrays


def _check_types(arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype not in TYPES:
            raise WireError(f"{name[:80]}: {array.dtype}: give float32 or uint8")


def main() -> None:
    """Serve the mode and the limits that the command line names, until the wire closes."""
    mode, limits = sys.argv[1], json.loads(sys.argv[2])
    if limits["parent"]:
        end_with(limits["parent"])
    import resource

    # Linux alone holds to a limit of address space; elsewhere setting it may fail.
    with contextlib.nullcontext() if sys.platform == "linux" else contextlib.suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (limits["memory"], limits["memory"]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    asked, answers = Connection(0, writable=False), Connection(1, readable=False)
    try:
        opened = MODES[mode]()
        _close_the_doors(limits["unconfined"])
        say(answers, ANSWER)  # not before this does the stranger's file come
    except Exception as error:
        say(answers, REFUSED, _text(error))
        return
    run: Run | None = None
    while True:
        try:
            kind, payload = hear(asked)
        except EOFError:
            return
        try:
            if kind == OPEN:
                run = opened(payload)
                say(answers, ANSWER)
            elif run is not None:
                say(answers, ANSWER, run(payload))
        except BaseException as error:
            say(answers, REFUSED, _text(error))
            return


def _close_the_doors(unconfined: bool) -> None:
    """Forbid further files, sockets, processes and privileges; the libraries are loaded by now."""
    import resource

    os.closerange(3, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    try:
        confine()
    except CannotConfineError:
        if not unconfined:
            raise
        open_no_more()


def _text(error: BaseException) -> bytes:
    if isinstance(error, CannotConfineError):
        return b"K" + str(error).encode()
    short = isinstance(error, MemoryError) or "alloc" in str(error)
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return (b"M" if short else b"E") + text[:MAX_TEXT].encode(errors="replace")


def _session() -> Callable[[bytes], Run]:
    """Run a graph: inputs in, all outputs back."""
    from racines_models.exchange.onnx.file import import_onnx, open_session

    import_onnx("onnxruntime")
    import onnxruntime

    onnxruntime.get_available_providers()

    def opened(content: bytes) -> Run:
        session = open_session(content, "the file", "cpu")
        names = [output.name for output in session.get_outputs()]

        def run(payload: bytes) -> bytes:
            outputs: list[Any] = list(session.run(names, unpack_arrays(payload)))
            return pack_arrays(dict(zip(names, outputs, strict=True)))

        return run

    return opened


def _parse_onnx() -> Callable[[bytes], Run]:
    """Parse and check a graph; nothing of it is run."""
    import onnx

    def opened(content: bytes) -> Run:
        onnx.checker.check_model(onnx.load_model_from_string(content))
        return bytes

    return opened


def _parse_parquet() -> Callable[[bytes], Run]:
    """Unpack every page of a file of predictions or motions, as its reader does."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_memory_pool(pa.system_memory_pool())

    def opened(content: bytes) -> Run:
        images = {"image"} & set(pq.read_schema(pa.BufferReader(content)).names)
        file = pq.ParquetFile(
            pa.BufferReader(content), read_dictionary=sorted(images), pre_buffer=False
        )
        for _ in file.iter_batches(64, use_threads=False):
            pass
        return bytes

    return opened


MODES = {"session": _session, "onnx": _parse_onnx, "parquet": _parse_parquet}

if __name__ == "__main__":
    main()
