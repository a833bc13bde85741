"""One video a sweep (MP4, MOV, MKV, AVI), through PyAV; counted without decoding."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.sources.images import Fault
from racines_data.sources.table.pictures.base import MOST_PIXELS, check_size

FORMATS = {".mp4": "mov", ".m4v": "mov", ".mov": "mov", ".mkv": "matroska", ".avi": "avi"}
"""The container of each ending; named to the library, so that no playlist opens other files."""
ENDINGS = tuple(FORMATS)


class Video:
    """Images of a video."""

    orientation = "MF"

    def __init__(self, path: Path) -> None:
        """Read the header and count the frames.

        Raises:
            RacinesError: PyAV is not installed, no video, or one too large.
        """
        self.path, self.files = path, [path]
        with self._open() as (container, stream):
            width, height = stream.codec_context.width, stream.codec_context.height
            claimed = stream.frames
            check_size(path, width, height, max(claimed, 1))
            self.count = sum(1 for packet in container.demux(stream) if packet.size)
        if claimed and self.count < claimed:
            raise RacinesError(
                f"{path}: truncated: {self.count} of {claimed} frames are there; copy it again"
            )
        check_size(path, width, height, self.count)
        self.size = width, height

    @contextmanager
    def _open(self) -> Iterator[tuple[Any, Any]]:
        av = needed("av", f"{self.path}: video")
        av.logging.set_level(None)
        options = {"max_pixels": str(MOST_PIXELS)}
        form = FORMATS[self.path.suffix.lower()]
        try:
            with av.open(str(self.path), format=form, stream_options=[options]) as container:
                if not container.streams.video:
                    raise RacinesError(f"{self.path}: no video in it")
                stream = container.streams.video[0]
                stream.codec_context.thread_count = 1
                yield container, stream
        except (av.FFmpegError, ValueError, MemoryError) as error:
            said = " ".join(str(error).split())[:160]
            raise RacinesError(f"{self.path}: damaged, or not a video ({said})") from error

    def __len__(self) -> int:
        """Return their number."""
        return self.count

    def check(self) -> tuple[list[tuple[int, int]], list[Fault | None]]:
        """Return the size of all: a video has one."""
        return [self.size] * self.count, [None] * self.count

    def read(self, indices: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the images as gray, decoded from the first on: seeking is not exact."""
        wanted, last, index = set(indices), max(indices, default=-1), -1
        with self._open() as (container, stream):
            for index, frame in enumerate(container.decode(stream)):
                if index in wanted:
                    yield frame.to_ndarray(format="gray")
                if index >= last:
                    return
        raise RacinesError(
            f"{self.path}: truncated: {index + 1} frames can be decoded, frame {last} is needed"
        )
