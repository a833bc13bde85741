"""Files that a stranger hands in: plain names, plain files, bounded, no pickle under any name.

A file is opened once, without following links, and all that is said of it is said of that open
file: what lies under its name a moment later is of no matter.
"""

import errno
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from _typeshed import SupportsRead

MAX_BYTES = 200 * 2**20
"""Largest artefact."""
CHUNK = 2**20
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
"""Devices under Windows, whatever the ending."""
CONTAINERS = {bytes([0x80, protocol]): "a pickle" for protocol in range(1, 6)} | {
    b"PK\x03\x04": "a zip archive (torch.save writes pickles in one)",
    b"PK\x05\x06": "a zip archive",
    b"PK\x07\x08": "a zip archive",
    b"\x1f\x8b": "a gzip archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ\x00": "an xz archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x28\xb5\x2f\xfd": "a zstd archive",
    b"\x93NUMPY": "a NumPy file, which may hold pickles",
    b"\x89HDF": "an HDF5 file, which may hold pickles",
    b"\x7fELF": "a program",
    b"MZ": "a program",
    b"#!": "a script",
}
OLD_PICKLE = re.compile(rb"[(\]}]|c[\w.]+\n[\w.]+\n")
"""How pickles of protocol 0 and 1, which have no mark of their own, begin."""
SAFETENSORS = b"\x00\x00\x00\x00{"
"""Bytes 4 to 8 of a safetensors file. Those before are its header's length, which may be any."""
REMEDY = (
    "a pickle can run code when it is loaded and an archive can unpack to anything: give "
    "safetensors, ONNX, Parquet or JSON"
)


def check_name(name: object, where: str) -> str:
    """Return the name of a file; refuse one that is a path, hidden, overlong or reserved."""
    if not isinstance(name, str) or not NAME.fullmatch(name) or RESERVED.fullmatch(name):
        raise RacinesError(
            f"{where}: {str(name)[:120]!r} refused: give the bare name of a file in the "
            "submission's folder, 1 to 100 of A-Z a-z 0-9 . _ -, the first a letter or digit"
        )
    return name


@contextmanager
def opened(folder: Path, name: str, where: str, limit: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """Open a regular file of a folder, no link, device or folder, of 1 to `limit` bytes."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        handle = os.open(folder / name, flags)
    except FileNotFoundError as error:
        raise RacinesError(f"{where}: {name}: no such file beside the submission") from error
    except OSError as error:
        link = error.errno == errno.ELOOP
        reason = "a symbolic link: put the file itself there" if link else error.strerror
        raise RacinesError(f"{where}: {name}: {reason}") from error
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise RacinesError(f"{where}: {name}: no regular file: put the file itself there")
    with os.fdopen(handle, "rb") as stream:
        if not 1 <= status.st_size <= limit:
            raise RacinesError(
                f"{where}: {name}: {status.st_size:,} bytes: give a file of 1 to {limit:,}"
            )
        yield stream


def read_bounded(folder: Path, name: str, where: str, limit: int) -> bytes:
    """Return the bytes of a file `opened`, at most `limit` even if it grows meanwhile."""
    with opened(folder, name, where, limit) as stream:
        content = stream.read(limit + 1)
    if len(content) > limit:
        raise RacinesError(f"{where}: {name}: more than {limit:,} bytes")
    return content


def measure(
    stream: "SupportsRead[bytes]", where: str, out: BinaryIO | None = None
) -> tuple[str, int]:
    """Return the sha256 and the size of a stream, copied into `out` on the way.

    One longer than MAX_BYTES is refused, and one that begins as a pickle or an archive does.
    """
    digest, size = hashlib.sha256(), 0
    while chunk := stream.read(CHUNK):
        if not size:
            _check_head(chunk[:512], where)
        size += len(chunk)
        if size > MAX_BYTES:
            raise RacinesError(f"{where}: more than {MAX_BYTES:,} bytes: give a smaller file")
        digest.update(chunk)
        if out is not None:
            out.write(chunk)
    return digest.hexdigest(), size


def _check_head(head: bytes, where: str) -> None:
    """Refuse what runs code or unpacks, by its first bytes and whatever its name."""
    if head[4:9] == SAFETENSORS:
        return
    found = [what for mark, what in CONTAINERS.items() if head.startswith(mark)]
    if head[257:262] == b"ustar":
        found.append("a tar archive")
    if OLD_PICKLE.match(head):
        found.append("a pickle")
    if found:
        raise RacinesError(f"{where} holds {found[0]}: refused; {REMEDY}")
