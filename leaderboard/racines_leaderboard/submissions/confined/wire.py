"""What parent and confined child say to each other: frames of raw bytes, never pickles.

    frame   "RCN1"  kind u8  length u64  payload
    arrays  count u8, then for each: name length u8, name, type u8, axes u8, sizes u64, values

All little-endian. A reader checks every length before it takes the bytes.
"""

import struct
from collections.abc import Mapping

import numpy as np

MAGIC = b"RCN1"
HEAD = struct.Struct("<4sBQ")
OPEN, RUN, ANSWER, REFUSED = range(1, 5)
"""Kinds: a file's bytes, inputs, outputs, and one line of text that says what is wrong."""
TYPES: tuple[np.dtype, ...] = (np.dtype("<f4"), np.dtype("u1"))
MAX_AXES = 8


class WireError(Exception):
    """Bytes that are no message."""


def frame(kind: int, payload: bytes = b"") -> bytes:
    """Return a message."""
    return HEAD.pack(MAGIC, kind, len(payload)) + payload


def frame_head(head: bytes, limit: int) -> tuple[int, int]:
    """Return the kind and the payload's length of a frame.

    Raises:
        WireError: no frame, or a payload of more than `limit` bytes.
    """
    magic, kind, length = HEAD.unpack(head)
    if magic != MAGIC or kind not in (OPEN, RUN, ANSWER, REFUSED):
        raise WireError("what came is no message")
    if length > limit:
        raise WireError(f"an answer of {length:,} bytes, more than {limit:,}")
    return kind, length


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return arrays as bytes.

    Raises:
        WireError: another type than float32 or uint8, or too many axes.
    """
    parts = [struct.pack("<B", len(arrays))]
    for name, array in arrays.items():
        if array.dtype not in TYPES or array.ndim > MAX_AXES:
            raise WireError(f"{name[:80]}: {array.dtype} of {array.ndim} axes: give float32, uint8")
        label = name.encode()[:255]
        parts += [struct.pack("<B", len(label)), label]
        parts.append(struct.pack("<BB", TYPES.index(array.dtype), array.ndim))
        parts.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        parts.append(np.ascontiguousarray(array).tobytes())
    return b"".join(parts)


def unpack_arrays(payload: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of `pack_arrays`, copied.

    Raises:
        WireError: a length that does not fit the bytes, or a type that is not known.
    """
    arrays: dict[str, np.ndarray] = {}
    try:
        (count,), at = struct.unpack_from("<B", payload), 1
        for _ in range(count):
            length = payload[at]
            name, at = payload[at + 1 : at + 1 + length].decode(), at + 1 + length
            (code, axes), at = struct.unpack_from("<BB", payload, at), at + 2
            if axes > MAX_AXES:
                raise WireError(f"{axes} axes")
            shape, at = struct.unpack_from(f"<{axes}Q", payload, at), at + 8 * axes
            size = 1
            for each in shape:
                size *= each
            array = np.frombuffer(payload, TYPES[code], size, at)
            arrays[name], at = array.reshape(shape).copy(), at + array.nbytes
    except (IndexError, ValueError, OverflowError, struct.error) as error:
        raise WireError(f"arrays that do not fit their header: {error}") from error
    if at != len(payload):
        raise WireError("arrays that do not fit their header: bytes are left over")
    return arrays
