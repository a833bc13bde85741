"""What all readers of images have in common: the protocol, and how large an image may be."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.images import Fault, resolution

MOST_PIXELS = 64_000_000
"""Pixels of one image, at most."""
MOST_BYTES = 32_000_000_000
"""Bytes of all images of a sweep once decoded, at most."""


class Stack(Protocol):
    """The images of one sweep, in order."""

    files: list[Path]
    """The files that hold them."""
    orientation: str
    """How they lie, as `racines_data.sources.tracked.source.upright` reads it."""

    def __len__(self) -> int:
        """Return how many there are, by the header."""
        ...

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Return (width, height) of each image, (0, 0) where unknown, and what is wrong with it.

        Raises:
            RacinesError: the file that holds them all cannot be used.
        """
        ...

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the (H, W) uint8 images of increasing indices, as they are stored.

        Raises:
            RacinesError: one cannot be read.
        """
        ...


def check_size(path: Path, width: int, height: int, count: int) -> None:
    """Refuse what a header claims and no memory holds, before anything is decoded."""
    said = f"{path}: its header says {count} images of {resolution((width, height))}"
    if min(width, height, count) < 1:
        raise RacinesError(f"{said}: nothing to read; empty, or a damaged header")
    if width * height > MOST_PIXELS:
        raise RacinesError(
            f"{said}: an image has at most {MOST_PIXELS:,} pixels; damaged, or scale them down"
        )
    if width * height * count > MOST_BYTES:
        raise RacinesError(
            f"{said}, {width * height * count / 1e9:.0f} GB once decoded: at most "
            f"{MOST_BYTES / 1e9:.0f}; damaged, or cut it into sweeps of their own files"
        )


def gray(pixels: np.ndarray, path: Path, what: str = "image") -> np.ndarray:
    """Return an (H, W) or (H, W, 3) uint8 image as (H, W) gray (ITU-R 601).

    Raises:
        RacinesError: another type or shape, with what to do about it.
    """
    if pixels.dtype != np.uint8:
        hint = "scale them to 0-255 and write uint8"
        raise RacinesError(f"{path}: {what}: gray levels are {pixels.dtype}: {hint}")
    if pixels.ndim == 2:
        return pixels
    if pixels.ndim == 3 and pixels.shape[2] in (3, 4):
        weights = np.array([299, 587, 114], np.uint32)
        return ((pixels[..., :3] * weights).sum(-1) // 1000).astype(np.uint8)
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        return pixels[..., 0]
    raise RacinesError(f"{path}: {what}: shape {pixels.shape}: give (rows, columns)")
