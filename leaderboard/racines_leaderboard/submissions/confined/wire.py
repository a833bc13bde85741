"""What parent and confined child say to each other: bytes through a pipe, never pickles.

A message is its kind and its payload, two byte strings of `multiprocessing.connection`, of which
`send_bytes` and `recv_bytes` alone are used: its `send` and `recv` would unpickle. Arrays are
packed by safetensors, whose reader checks every length before it takes the bytes.
"""

from collections.abc import Mapping
from multiprocessing.connection import Connection

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

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
