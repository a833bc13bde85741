"""One `.mha` sequence a sweep, read as the source `tracked` reads it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from racines_data.sources.images import Fault
from racines_data.sources.table.pictures.base import check_size
from racines_data.sources.tracked.source import read_frames, read_header

ENDINGS = (".mha",)


class ImageSequence:
    """Images of a PLUS sequence; poses in it are left to the table."""

    def __init__(self, path: Path) -> None:
        """Read the header.

        Raises:
            RacinesError: no such sequence, or one too large.
        """
        self.path, self.files = path, [path]
        self.header = read_header(path)
        check_size(path, self.header.width, self.header.height, len(self.header.frames))
        self.orientation = self.header.orientation or "MF"

    def __len__(self) -> int:
        """Return their number."""
        return len(self.header.frames)

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Unpack it once, so that a truncated file is found before anything is made of it."""
        for _ in read_frames(self.header):
            pass
        size = self.header.width, self.header.height
        return [size] * len(self), [None] * len(self)

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the images, one in memory at a time."""
        wanted = set(indices)
        for index, image in enumerate(read_frames(self.header)):
            if index in wanted:
                yield image
