"""One NumPy array a sweep: (T, rows, columns) uint8, gray or in colours; mapped, not read."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.images import Fault
from racines_data.sources.table.pictures.base import check_size, gray

ENDINGS = (".npy",)


class Array:
    """Images of an array on disk."""

    orientation = "MF"

    def __init__(self, path: Path) -> None:
        """Read the header.

        Raises:
            RacinesError: no array of gray levels, or shorter than its header says.
        """
        self.path, self.files = path, [path]
        shape = self._open().shape
        self.count, self.size = shape[0], (shape[2], shape[1])

    def _open(self) -> np.ndarray:
        try:
            array = np.load(self.path, mmap_mode="r", allow_pickle=False)
        except (ValueError, OSError, EOFError) as error:
            said = " ".join(str(error).split())[:160]
            raise RacinesError(f"{self.path}: not a whole array of numbers ({said})") from error
        if array.ndim not in (3, 4) or array.ndim == 4 and array.shape[3] not in (1, 3, 4):
            raise RacinesError(f"{self.path}: shape {array.shape}: give (T, rows, columns)")
        if array.dtype != np.uint8:
            raise RacinesError(
                f"{self.path}: {array.dtype}: likely 0-1 or 16 bits: scale to 0-255 and write uint8"
            )
        check_size(self.path, array.shape[2], array.shape[1], array.shape[0])
        return array

    def __len__(self) -> int:
        """Return their number."""
        return self.count

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Return the size of all: the header was checked against the file's length."""
        return [self.size] * self.count, [None] * self.count

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the images as gray."""
        array = self._open()
        for index in indices:
            yield gray(np.asarray(array[index]), self.path)
