"""Checking one image folder of the published recordings: which frames can be used."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from racines_data.sources.base import Finding
from racines_data.sources.images import DamagedImage, check_png
from racines_data.sources.release.checks import UNIT_KINDS, Fault, Limits, backward, check_numbers
from racines_data.sources.release.kinds import Kind, flagged, refused
from racines_data.sources.release.log import TIME, WIDTH, DamagedLog, parse_log
from racines_data.sources.release.tree import Pair, SweepFolder, pair_files

_CHUNK = 64


class FolderSurvey(NamedTuple):
    """What one image folder holds."""

    pairs: list[Pair]
    """Frames to keep, in order."""
    size: tuple[int, int]
    """Width and height of their images."""
    digest: bytes
    """Of the names and bytes of all pairs of files."""


class _Reading(NamedTuple):
    """What one frame's files hold; `finding` says why there are no numbers."""

    numbers: list[float] | None
    size: tuple[int, int]
    finding: Finding | None
    digest: bytes


@dataclass
class Surveyor:
    """Checks the image folders of one release, and reports what cannot be used."""

    root: Path
    limits: Limits
    report: list[Finding]
    pool: ThreadPoolExecutor

    def survey(self, recording: SweepFolder) -> FolderSurvey:
        """Read every file of a recording once."""
        pairs = pair_files(self.root, recording, self.report)
        chunks = [pairs[start : start + _CHUNK] for start in range(0, len(pairs), _CHUNK)]
        jobs = self.pool.map(lambda part: [self._read(recording, pair) for pair in part], chunks)
        readings = [reading for chunk in jobs for reading in chunk]
        digest = hashlib.sha256(recording.where.encode())
        for pair, reading in zip(pairs, readings, strict=True):
            digest.update(f"{pair.image}\0{pair.log}\0".encode() + reading.digest)
        self.report += [reading.finding for reading in readings if reading.finding]
        kept = [index for index, reading in enumerate(readings) if reading.numbers is not None]
        kept, size = self._one_size(recording, pairs, readings, kept)
        rows = np.array([readings[index].numbers for index in kept], float).reshape(-1, WIDTH)
        kept, rows = self._sound(recording, pairs, kept, rows)
        kept = self._in_time(recording, pairs, kept, rows[:, TIME])
        return FolderSurvey([pairs[index] for index in kept], size, digest.digest())

    def _read(self, recording: SweepFolder, pair: Pair) -> _Reading:
        size, content = (0, 0), [b"", b""]
        image, log = f"{recording.where}/{pair.image}", self._log(recording, pair)
        try:
            content[0] = (recording.images / pair.image).read_bytes()
            size = check_png(content[0])
            content[1] = (recording.logs / pair.log).read_bytes()
            numbers = parse_log(content[1].decode("utf-8", "replace"))
            finding = None
        except DamagedImage as error:
            numbers, finding = None, refused(error.kind, image, error.detail)
        except DamagedLog as error:
            numbers, finding = None, refused(error.kind, log, error.detail, error.field)
        except OSError as error:
            kind, file = (
                (Kind.UNREADABLE_LOG, log) if content[0] else (Kind.UNREADABLE_IMAGE, image)
            )
            numbers, finding = None, refused(kind, file, f"{error.strerror}")
        digest = b"".join(hashlib.sha256(part).digest() for part in content)
        return _Reading(numbers, size, finding, digest)

    def _one_size(
        self,
        recording: SweepFolder,
        pairs: Sequence[Pair],
        readings: Sequence[_Reading],
        kept: Sequence[int],
    ) -> tuple[list[int], tuple[int, int]]:
        """Keep the images of the commonest size: another size is another crop of the screen."""
        sizes = Counter(readings[index].size for index in kept)
        usual = max(sizes, key=lambda size: (sizes[size], size), default=(0, 0))
        for index in kept:
            width, height = readings[index].size
            if (width, height) != usual:
                detail = f"{width}×{height}, {sizes[usual]} others are {usual[0]}×{usual[1]}"
                file = f"{recording.where}/{pairs[index].image}"
                self.report.append(refused(Kind.MIXED_SIZES, file, detail))
        return [index for index in kept if readings[index].size == usual], usual

    def _sound(
        self, recording: SweepFolder, pairs: Sequence[Pair], kept: Sequence[int], rows: np.ndarray
    ) -> tuple[list[int], np.ndarray]:
        """Keep the frames whose numbers are sound."""
        faults = check_numbers(rows, self.limits)
        unit = _common_unit(faults)
        if unit:
            # One line for a folder, not one for each of its thousands of frames.
            detail = f"all {len(faults)} frames: {unit.detail}"
            found = refused(unit.kind, recording.where, detail, unit.field, len(faults))
            self.report.append(found)
            return [], rows[:0]
        for index, fault in zip(kept, faults, strict=True):
            if fault:
                file = self._log(recording, pairs[index])
                self.report.append(refused(fault.kind, file, fault.detail, fault.field))
        good = [place for place, fault in enumerate(faults) if fault is None]
        return [kept[place] for place in good], rows[good]

    def _in_time(
        self, recording: SweepFolder, pairs: Sequence[Pair], kept: Sequence[int], times: np.ndarray
    ) -> list[int]:
        """Keep the frames in whose order the clock runs on; flag where it may stand still."""
        lost = backward(times.tolist(), self.limits.allow_repeats)
        for place in lost:
            file = self._log(recording, pairs[kept[place]])
            detail = f"{times[place]:.6f} s does not go on from its neighbours' times"
            self.report.append(refused(Kind.CLOCK, file, detail, "Time"))
        stopped = int((np.diff(np.delete(times, lost)) == 0).sum())
        if stopped:
            detail = f"{stopped} frames have the time of the frame before; they are kept"
            self.report.append(flagged(Kind.CLOCK, recording.where, detail, "Time", stopped))
        return [index for place, index in enumerate(kept) if place not in set(lost)]

    def _log(self, recording: SweepFolder, pair: Pair) -> str:
        return (recording.logs / pair.log).relative_to(self.root).as_posix()


def _common_unit(faults: Sequence[Fault | None]) -> Fault | None:
    """Return a fault that says so if every frame, of several, is in one other unit."""
    found = [fault for fault in faults if fault]
    kinds = {fault.kind for fault in found}
    if len(found) < max(len(faults), 2) or len(kinds) > 1:
        return None
    return found[0] if kinds & set(UNIT_KINDS.values()) else None
