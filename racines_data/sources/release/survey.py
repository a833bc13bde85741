"""Checking one image folder of the published recordings: which frames can be used."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from racines_data.sources.folder import Fault, Kind, Report
from racines_data.sources.images import check_png, resolution
from racines_data.sources.release.checks import UNIT_KINDS, ReleaseConfig, backward, check_numbers
from racines_data.sources.release.log import TIME, WIDTH, parse_log
from racines_data.sources.release.tree import Pair, SweepFolder, pair_files

_CHUNK = 64


class FolderSurvey(NamedTuple):
    """What one image folder holds."""

    folder: SweepFolder
    pairs: list[Pair]
    """Frames to keep, in order."""
    size: tuple[int, int]
    """Width and height of their images."""
    digest: bytes
    """Of the names and bytes of all pairs of files."""


@dataclass
class _Frame:
    """One frame's files, and what they hold."""

    pair: Pair
    image: Path
    log: Path
    numbers: list[float] | None = None
    size: tuple[int, int] = (0, 0)
    fault: Fault | None = None
    """Why there are no numbers."""
    digest: bytes = b""


def _read(frames: list[_Frame]) -> list[_Frame]:
    """Read the files of some frames; return the frames."""
    for frame in frames:
        image = log = b""
        try:
            image = frame.image.read_bytes()
            frame.size = check_png(image)
            log = frame.log.read_bytes()
            frame.numbers = parse_log(log.decode("utf-8", "replace"))
        except Fault as error:
            frame.fault = error
        except OSError as error:
            kind = Kind.UNREADABLE_LOG if image else Kind.UNREADABLE_IMAGE
            frame.fault = Fault(kind, f"{error.strerror}")
        frame.digest = hashlib.sha256(image).digest() + hashlib.sha256(log).digest()
    return frames


@dataclass
class Surveyor:
    """Checks the image folders of one release, and reports what cannot be used."""

    config: ReleaseConfig
    report: Report
    pool: ThreadPoolExecutor

    def survey(self, folder: SweepFolder) -> FolderSurvey:
        """Read every file of a recording once."""
        pairs = pair_files(folder, self.report)
        frames = [_Frame(p, folder.images / p.image, folder.logs / p.log) for p in pairs]
        digest = hashlib.sha256(self.report.place(folder.images).encode())
        chunks = [frames[start : start + _CHUNK] for start in range(0, len(frames), _CHUNK)]
        for frame in chain.from_iterable(self.pool.map(_read, chunks)):
            digest.update(f"{frame.pair.image}\0{frame.pair.log}\0".encode() + frame.digest)
            if frame.fault:
                file = frame.log if frame.size != (0, 0) else frame.image
                self.report.refuse(frame.fault.kind, file, frame.fault.detail, frame.fault.item)
        frames, size = self._one_size([frame for frame in frames if frame.numbers is not None])
        frames = self._in_time(folder, self._sound(folder, frames))
        return FolderSurvey(folder, [frame.pair for frame in frames], size, digest.digest())

    def _one_size(self, frames: Sequence[_Frame]) -> tuple[list[_Frame], tuple[int, int]]:
        """Keep the images of the commonest size: another size is another crop of the screen."""
        sizes = Counter(frame.size for frame in frames)
        usual = max(sizes, key=lambda size: (sizes[size], size), default=(0, 0))
        for frame in frames:
            if frame.size != usual:
                detail = f"{resolution(frame.size)}, {sizes[usual]} others are {resolution(usual)}"
                self.report.refuse(Kind.MIXED_SIZES, frame.image, detail)
        return [frame for frame in frames if frame.size == usual], usual

    def _sound(self, folder: SweepFolder, frames: Sequence[_Frame]) -> list[_Frame]:
        """Keep the frames whose numbers are sound."""
        faults = check_numbers(_rows(frames), self.config)
        unit = _common_unit(faults)
        if unit:
            # One line for a folder, not one for each of its thousands of frames.
            detail = f"all {len(faults)} frames: {unit.detail}"
            self.report.refuse(unit.kind, folder.images, detail, unit.item, len(faults))
            return []
        for frame, fault in zip(frames, faults, strict=True):
            if fault:
                self.report.refuse(fault.kind, frame.log, fault.detail, fault.item)
        return [frame for frame, fault in zip(frames, faults, strict=True) if not fault]

    def _in_time(self, folder: SweepFolder, frames: Sequence[_Frame]) -> list[_Frame]:
        """Keep the frames in whose order the clock runs on; flag where it may stand still."""
        times = _rows(frames)[:, TIME]
        lost = backward(times.tolist(), self.config.allow_repeats)
        for index in lost:
            detail = f"{times[index]:.6f} s does not go on from its neighbours' times"
            self.report.refuse(Kind.CLOCK, frames[index].log, detail, "Time")
        stopped = int((np.diff(np.delete(times, lost)) == 0).sum())
        if stopped:
            detail = f"{stopped} frames have the time of the frame before; they are kept"
            self.report.flag(Kind.CLOCK, folder.images, detail, "Time", stopped)
        return [frames[index] for index in np.delete(np.arange(len(frames)), lost)]


def _rows(frames: Sequence[_Frame]) -> np.ndarray:
    """Return (T, 29) float64."""
    return np.array([frame.numbers for frame in frames], float).reshape(-1, WIDTH)


def _common_unit(faults: Sequence[Fault | None]) -> Fault | None:
    """Return a fault that says so if every frame, of several, is in one other unit."""
    found = [fault for fault in faults if fault]
    kinds = {fault.kind for fault in found}
    if len(found) < max(len(faults), 2) or len(kinds) > 1:
        return None
    return found[0] if kinds & set(UNIT_KINDS.values()) else None
