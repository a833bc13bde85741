"""DICOM through pydicom: one file of many frames a sweep, or one file an image.

Of the header, only what says how pixels are stored is read; nothing that names a person is kept.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.sources.images import Fault, Kind
from racines_data.sources.table.pictures.base import check_size, gray

ENDINGS = (".dcm", ".dicom")


class Dicom:
    """Images of DICOM files: all frames of the first, of the second, and so on."""

    orientation = "MF"

    def __init__(self, paths: Sequence[Path]) -> None:
        """Read the headers.

        Raises:
            RacinesError: pydicom is not installed, a file is no DICOM image of 8 bits, or too
                large.
        """
        self.files = list(paths)
        self.frames: list[tuple[Path, int]] = []
        self.sizes: list[tuple[int, int]] = []
        for path in paths:
            header = self._header(path)
            count = int(header.get("NumberOfFrames") or 1)
            size = int(header.get("Columns") or 0), int(header.get("Rows") or 0)
            check_size(path, *size, count)
            if (bits := header.get("BitsAllocated")) != 8:
                raise RacinesError(f"{path}: {bits} bits a channel: export it with 8")
            self.frames += [(path, index) for index in range(count)]
            self.sizes += [size] * count
        check_size(paths[0], *self.sizes[0], len(self.frames))

    def _header(self, path: Path) -> Any:
        pydicom = needed("pydicom", f"{path}: DICOM")
        try:
            return pydicom.dcmread(path, stop_before_pixels=True)
        except (pydicom.errors.InvalidDicomError, ValueError, OSError, EOFError) as error:
            raise RacinesError(f"{path}: not a DICOM file, or damaged ({error})") from error

    def __len__(self) -> int:
        """Return their number."""
        return len(self.frames)

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Decode each file's last frame: a truncated one is found before anything is made of it."""
        faults: list[Fault | None] = []
        for path in self.files:
            own = [index for name, index in self.frames if name == path]
            try:
                self._pixels(path, own[-1])
                faults += [None] * len(own)
            except RacinesError as error:
                detail = str(error).removeprefix(f"{path}: ")
                faults += [Fault(Kind.UNREADABLE_IMAGE, detail)] * len(own)
        return self.sizes, faults

    def _pixels(self, path: Path, index: int) -> np.ndarray:
        pixels = needed("pydicom.pixels", f"{path}: DICOM")
        try:
            return gray(np.asarray(pixels.pixel_array(path, index=index)), path)
        except (ValueError, RuntimeError, AttributeError, NotImplementedError, OSError) as error:
            said = " ".join(str(error).split())[:200]
            raise RacinesError(f"{path}: its pixels cannot be decoded ({said})") from error

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the images as gray."""
        for index in indices:
            yield self._pixels(*self.frames[index])
