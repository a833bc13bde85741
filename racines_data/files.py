"""Files that readers never see half-written, and their hashes."""

import hashlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout
from PIL import Image

from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from torch import Tensor


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let what the system refuses while a file is written name that file.

    A full disk names none, and a file in the making has a temporary name that says nothing.
    """
    try:
        yield
    except OSError as error:
        # A parent that cannot be made, or written into, stays the one that is named.
        made = str(error.filename or "")
        if not made or Path(made).name.startswith(f".{path.name}"):
            told = OSError(error.errno, error.strerror or str(error), str(path))
            raise told from error
        raise


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write a file under a temporary name in its folder, then rename it into place."""
    data = content.encode() if isinstance(content, str) else content
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


def write_once(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` make a large file under another name, then rename it; not if it is there.

    Of processes that want the same file one writes it, and the others wait.

    Raises:
        RacinesError: another has not let go of it after ten minutes.
    """
    if path.exists():  # also where nobody may write
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    busy = f"{path}: another process has been writing it for 600 s: wait for it, or end it"
    with _held(path.with_name(f".{path.name}.lock"), 600, busy):
        if not path.exists():
            aside = path.with_name(f"{path.name}.part")
            write(aside)
            os.replace(aside, path)


def read_tensors(
    path: Path, names: Iterable[str] = (), remedy: str = "remove it, it is made anew"
) -> "dict[str, Tensor]":
    """Return the tensors of a safetensors file: those named, or all.

    Raises:
        RacinesError: a damaged file, or one without a tensor of those names; with the remedy.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        found = load_file(path)
        return {name: found[name] for name in names or found}
    except (SafetensorError, KeyError, OSError) as error:
        raise RacinesError(f"{path}: damaged ({error}): {remedy}") from error


def swap_folder(new: Path, out: Path) -> None:
    """Put a finished folder in the place of another; `recover_folder` undoes half a swap."""
    old = _aside(out)
    shutil.rmtree(old, ignore_errors=True)
    if out.exists():
        os.replace(out, old)
    os.replace(new, out)
    shutil.rmtree(old, ignore_errors=True)


def recover_folder(out: Path) -> None:
    """Put back the folder that a process killed between the two renames of a swap moved aside."""
    old = _aside(out)
    if old.exists() and not out.exists():
        with locked_place(out):  # else it may be one that is between the two at this moment
            if old.exists() and not out.exists():
                os.replace(old, out)


@contextmanager
def working_folder(out: Path, kind: str, key: str, busy: str) -> Iterator[Path]:
    """Open the folder of unfinished work on `out`, beside it; removed when the work is done.

    `key` is all that decides what the work makes. What a killed process left is gone on with by the
    same key, and removed by work of another, which will never go on from it.

    Raises:
        RacinesError: another process is at the same work; `busy` says so.
    """
    folder = out.parent / f".{out.name}.{kind}-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(folder / "lock", blocking=False).acquire()
    except Timeout as error:
        raise RacinesError(f"{out}: {busy}") from error
    with lock:
        for other in set(out.parent.glob(f".{out.name}.{kind}-*")) - {folder}:
            with suppress(Timeout), FileLock(other / "lock", blocking=False):
                shutil.rmtree(other)
        yield folder
        if os.name == "nt":  # which removes no file that is open
            lock.release()
        shutil.rmtree(folder)


@contextmanager
def locked(folder: Path, seconds: float = 120) -> Iterator[None]:
    """Let one process at a time write into a folder, which is made; others wait.

    Raises:
        RacinesError: another has not let go of it after so many seconds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    busy = f"{folder}: another process has been writing there for {seconds:g} s"
    with _held(folder / ".lock", seconds, f"{busy}: wait for it, or end it"):
        yield


@contextmanager
def locked_place(out: Path, seconds: float = 600) -> Iterator[None]:
    """Let one process at a time read a folder and put another in its place; others wait.

    Raises:
        RacinesError: another has not let go of it after so many seconds.
    """
    busy = f"{out}: another process has been writing it for {seconds:g} s"
    with _held(out.parent / f".{out.name}.lock", seconds, f"{busy}: wait for it, or end it"):
        yield


@contextmanager
def _held(path: Path, seconds: float, busy: str) -> Iterator[None]:
    """Hold a file's lock; the file is gone when nobody does."""
    try:
        lock = FileLock(path, timeout=seconds).acquire()
    except Timeout as error:
        raise RacinesError(busy) from error
    with lock:
        try:
            yield
        finally:
            # While it is held: who waits at it sees that it is gone, and makes another. Windows
            # removes no file that is open, so there it stays.
            with suppress(PermissionError):
                path.unlink(missing_ok=True)


def _aside(out: Path) -> Path:
    return out.parent / f".{out.name}.old"


def cache_folder() -> Path:
    """Return the user's folder of what can be made or fetched again: ~/.cache/racines."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "racines"


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON atomically."""
    write_atomic(path, json.dumps(content, indent=2) + "\n")


def image_bytes(image: Image.Image, **options: Any) -> bytes:
    """Encode a picture as PNG, with PIL's options."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG", **options)
    return buffer.getvalue()


def sha256_file(path: Path) -> str:
    """Return the sha256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sampled_sha256(path: Path) -> str:
    """Return the sha256 of at most 64 blocks of 4 KiB, evenly from a file's first to its last."""
    digest, last = hashlib.sha256(), max(path.stat().st_size - _BLOCK, 0)
    with path.open("rb") as file:
        for place in sorted({last * i // (_BLOCKS - 1) for i in range(_BLOCKS)}):
            file.seek(place)
            digest.update(file.read(_BLOCK))
    return digest.hexdigest()


_BLOCK, _BLOCKS = 4096, 64
