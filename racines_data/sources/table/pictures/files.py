"""One file an image: PNG, JPEG, or single DICOM frames."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.images import Fault, Kind, check_jpeg, check_png, read_gray

LARGEST = 256_000_000
"""Bytes of an image file, at most."""
ENDINGS = (".png", ".jpg", ".jpeg")


class Files:
    """Images in files of their own; a path of None is one that is not there."""

    orientation = "MF"

    def __init__(self, paths: Sequence[Path | None], missing: dict[int, str] | None = None) -> None:
        """Take the paths in order, and why those that are None are."""
        self.paths, self.missing = list(paths), missing or {}
        self.files = sorted({path for path in paths if path is not None})

    def __len__(self) -> int:
        """Return their number."""
        return len(self.paths)

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Check each file whole, without decoding it (PNG) or at an eighth (JPEG)."""
        sizes: list[tuple[int, int]] = [(0, 0)] * len(self.paths)
        faults: list[Fault | None] = [None] * len(self.paths)
        known: dict[Path, tuple[int, int] | Fault] = {}
        for index, path in enumerate(self.paths):
            if path is None:
                faults[index] = Fault(Kind.MISSING_IMAGE, self.missing.get(index, "no such file"))
                continue
            if path not in known:
                known[path] = _look(path)
            found = known[path]
            if isinstance(found, Fault):
                faults[index] = found
            else:
                sizes[index] = found
        return sizes, faults

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the images as gray."""
        for index in indices:
            path = self.paths[index]
            if path is None:
                raise RacinesError(f"image {index}: {self.missing.get(index, 'no such file')}")
            yield read_gray(path)


def _look(path: Path) -> tuple[int, int] | Fault:
    try:
        if (size := path.stat().st_size) > LARGEST:
            return Fault(Kind.UNREADABLE_IMAGE, f"{size / 1e6:.0f} MB, at most {LARGEST / 1e6:.0f}")
        content = path.read_bytes()
        return check_png(content) if path.suffix.lower() == ".png" else check_jpeg(content)
    except Fault as fault:
        return fault
    except OSError as error:
        return Fault(Kind.UNREADABLE_IMAGE, f"{error.strerror}")
