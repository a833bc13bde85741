"""Tracked freehand ultrasound: PLUS sequences (`.igs.mha`), any organ, any tracker; no force.

The pose is that of the tracked probe marker in the tracker's frame, as the file has it: the files
hold no calibration from the image to the marker. One file is one sweep and one session; it is cut
into contiguous segments that stand as trajectories, so that splits by trajectory exist.
"""

import dataclasses
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, SourceCard, Unit
from racines_data.sources.folder import UNITS, parameters_of, recorded
from racines_data.sources.gate.bounds import TRACKER, Bounds
from racines_data.sources.gate.numbers import LENGTHS, likely_unit, rotation_faults
from racines_data.sources.images import Kind, square
from racines_data.sources.table.inputs import named_file
from racines_data.views import RANDOM

READER = 2
"""Version of what this reader makes of a file; part of the recipe. 2: the nearest rotations."""
FARTHEST = TRACKER.reach
"""No tracker sees a probe from farther away, m."""
NEAREST = TRACKER.nearest
"""No tracker has a whole sweep nearer to its origin, m."""
_USUAL = 1.0  # ordinary distance of a probe from a tracker, m
_FRAME = re.compile(r"Seq_Frame(\d+)_(\w+)")
_CHUNK = 1 << 20
_LONGEST = 1 << 16  # bytes of a header's line
_MOST_PIXELS = 64_000_000  # of one frame, which is in memory
_READ = {
    "ObjectType": "Image",
    "NDims": "3",
    "ElementType": "MET_UCHAR",
    "ElementNumberOfChannels": "1",
    "ElementDataFile": "LOCAL",
}
"""What a header has to say for its frames to be read."""


@dataclass(frozen=True)
class Recording:
    """Header of a sequence file."""

    path: Path
    width: int
    height: int
    compressed: bool
    orientation: str
    """Transducer axes along the image's x, y (and z): M/U marked or unmarked side, F/N far or near,
    A/D ascending or descending elevation; empty if the header does not say."""
    offset: int
    """First byte of the data."""
    frames: list[dict[str, str]] = field(repr=False)
    """Fields of each frame without their `Seq_FrameNNNN_` prefix."""


def read_header(path: Path) -> Recording:
    """Read the header of a sequence file.

    Raises:
        RacinesError: not such a file, or a kind of image that is not read here.
    """
    fields: dict[str, str] = {}
    by_frame: dict[int, dict[str, str]] = {}
    with path.open("rb") as file:
        for line in iter(lambda: file.readline(_LONGEST), b""):
            key, equals, value = map(str.strip, line.decode("latin-1").partition("="))
            if not equals or (not fields and key != "ObjectType"):
                break
            match = _FRAME.fullmatch(key)
            target = by_frame.setdefault(int(match[1]), {}) if match else fields
            target[match[2] if match else key] = value
            if key == "ElementDataFile":
                return _sequence(path, fields, by_frame, file.tell())
    raise RacinesError(f"{path}: not a PLUS sequence, or its header is cut off; give a .igs.mha")


def _sequence(
    path: Path, fields: dict[str, str], by_frame: dict[int, dict[str, str]], offset: int
) -> Recording:
    fields.setdefault("ElementNumberOfChannels", "1")
    for key, value in _READ.items():
        if fields.get(key) != value:
            raise RacinesError(
                f"{path}: {key} is {fields.get(key, 'missing')}, only {value} is read; convert it"
            )
    try:
        width, height, count = (int(size) for size in fields["DimSize"].split())
    except (KeyError, ValueError) as error:
        raise RacinesError(f"{path}: DimSize is missing or not three numbers") from error
    if min(width, height, count) < 1 or any(index >= count for index in by_frame):
        raise RacinesError(f"{path}: DimSize {fields['DimSize']} does not fit the frames' fields")
    if width * height > _MOST_PIXELS:
        raise RacinesError(
            f"{path}: DimSize {fields['DimSize']}: more than {_MOST_PIXELS:,} pixels"
        )
    compressed = fields.get("CompressedData", "False") == "True"
    orientation = fields.get("UltrasoundImageOrientation", "")
    frames = [by_frame.get(index, {}) for index in range(count)]
    return Recording(path, width, height, compressed, orientation, offset, frames)


def read_frames(recording: Recording) -> Iterator[np.ndarray]:
    """Yield each frame as (height, width) uint8, as stored; one is in memory at a time.

    Raises:
        RacinesError: the data ends early or cannot be unpacked.
    """
    size, pending, read = recording.width * recording.height, bytearray(), 0
    for block in _blocks(recording):
        pending += block
        while len(pending) >= size and read < len(recording.frames):
            image = np.frombuffer(bytes(pending[:size]), np.uint8)
            del pending[:size]
            read += 1
            yield image.reshape(recording.height, recording.width)
    if read < len(recording.frames):
        raise RacinesError(
            f"{recording.path}: truncated: {read} of {len(recording.frames)} frames are there; "
            "copy the file again"
        )


def _blocks(recording: Recording) -> Iterator[bytes]:
    """Yield the data, unpacked where they are compressed."""
    unpack = zlib.decompressobj() if recording.compressed else None
    with recording.path.open("rb") as file:
        file.seek(recording.offset)
        for block in iter(lambda: file.read(_CHUNK), b""):
            if unpack is None:
                yield block
                continue
            try:
                yield unpack.decompress(block, _CHUNK)
                while unpack.unconsumed_tail:
                    yield unpack.decompress(unpack.unconsumed_tail, _CHUNK)
            except zlib.error as error:
                raise RacinesError(f"{recording.path}: damaged image data ({error})") from error
    if unpack is not None:
        yield unpack.flush()


def upright(image: np.ndarray, orientation: str) -> np.ndarray:
    """Return an (H, W) image with the marked side of the probe at the right and depth downwards.

    Raises:
        RacinesError: an orientation (see `Recording`) that is not that of a B-mode image.
    """
    if not re.fullmatch("[MU][FN][AD]?", orientation):
        raise RacinesError(
            f"UltrasoundImageOrientation {orientation or 'missing'}: one of MF, UF, MN, UN "
            "expected; give it as the source's `orientation`"
        )
    image = image[:, ::-1] if orientation[0] == "U" else image
    return image[::-1] if orientation[1] == "N" else image


CARD = SourceCard(
    origin="tracked freehand ultrasound, imported; poses of the tracked probe, no forces",
    rights="As the recordings imported. This import adds no rights.",
    labelled=False,
    collection="Freehand sweeps with a tracked probe, imported; poses are those of the probe "
    "marker.",
    collection_type="Direct measurement",
    annotation="None: there are no views and no grades.",
    biases="As the recordings; a few sweeps of one subject are the rule.",
    limitations="Segments of one sweep stand as trajectories, so scores on the splits are "
    "optimistic. There are no forces, views or grades, and the marker's pose is not the image "
    "plane's.",
    personal="Depends on the recordings: whoever imports sweeps of persons is answerable for "
    "consent and de-identification. Only pixels, poses and times are kept; other header fields "
    "are not.",
    limits="A recording is one sweep. It is cut into contiguous segments, which stand as "
    "trajectories so that splits exist; frames on both sides of a cut are neighbours in time, so "
    "scores on such splits are optimistic. Poses are those of the tracked probe marker in the "
    "tracker's frame, not of the image plane; there are no forces, views or grades.",
)


@dataclass(frozen=True)
class TrackedConfig:
    """How tracked sequences are read."""

    transform: str = "ProbeToTracker"
    """Name of the transform that is the pose, without its ending `Transform`."""
    unit: str = "mm"
    """Unit of its translation: `mm` (as PLUS writes it) or `m`."""
    orientation: str = ""
    """Image orientation, to replace the header's; empty to use the header's."""
    segments: int = 5
    """Trajectories that a sweep is cut into."""
    tolerance: float = 1e-3
    """Largest error of a rotation's orthonormality, per element of R Rᵀ - 1."""


@dataclass(frozen=True)
class TrackedUnit(Unit):
    """A segment of a sweep."""

    path: Path
    indices: tuple[int, ...]
    """Frames of the file, increasing."""


@dataclass
class TrackedSource:
    """Reads PLUS sequence files."""

    config: TrackedConfig
    inputs: tuple[Path, ...]
    report: list[Finding] = field(default_factory=list)
    name = "tracked"
    version = "0.1.0"
    Config = TrackedConfig
    card = CARD
    of_users: ClassVar[bool] = True
    bounds: ClassVar[Bounds] = TRACKER

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> "TrackedSource":
        """Make the source; `inputs` are sequence files.

        Raises:
            RacinesError: no inputs, a missing one, two of one name, or a wrong setting.
        """
        settings = fill(TrackedConfig, config, "data.tracked")
        if settings.unit not in UNITS:
            raise RacinesError(f"data.tracked.unit {settings.unit!r}: choose mm or m")
        if settings.segments < 1:
            raise RacinesError("data.tracked.segments: give one or more")
        if not inputs:
            raise RacinesError("source tracked: name its files: --input SWEEP.igs.mha")
        for path in inputs:
            named_file(path, "name a .igs.mha file")
        names = [_stem(path) for path in inputs]
        if len(set(names)) < len(names):
            raise RacinesError(f"two inputs have one name ({', '.join(sorted(names))}); rename one")
        return cls(settings, tuple(sorted(inputs, key=_stem)))

    def recipe(self) -> dict[str, Any]:
        """Return the reader's version, the settings and the inputs' sha256."""
        inputs = {_stem(path): sha256_file(path) for path in self.inputs}
        return {"reader": READER, "config": dataclasses.asdict(self.config), "inputs": inputs}

    def plan(self) -> list[TrackedUnit]:
        """Check every frame of every file, and cut what is kept into segments."""
        self.report = []
        units: list[TrackedUnit] = []
        for path in self.inputs:
            frames = 1
            try:
                recording = read_header(path)
                frames = len(recording.frames)
                kept = self._check(recording)
            except RacinesError as error:
                self.report.append(Finding(path.name, "", True, str(error), frames))
                continue
            if not kept:
                continue  # every frame is in the report
            segments = np.array_split(np.array(kept, int), min(self.config.segments, len(kept)))
            for number, indices in enumerate(segments):
                names = f"{_stem(path)}-{number:02d}", _stem(path), RANDOM
                units.append(TrackedUnit(*names, len(indices), path, tuple(indices.tolist())))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Read a segment: square 128×128 images, poses in metres and radians, no forces."""
        assert isinstance(unit, TrackedUnit)
        recording = read_header(unit.path)
        orientation = self.config.orientation or recording.orientation
        wanted = set(unit.indices)
        images = [
            square(upright(image, orientation))
            for index, image in enumerate(read_frames(recording))
            if index in wanted
        ]
        fields = [recording.frames[index] for index in unit.indices]
        matrices = np.stack([self._matrix(each) for each in fields])
        times = np.array([float(each["Timestamp"]) for each in fields])
        parameters = parameters_of(matrices, tolerance=self.config.tolerance, nearest=True)
        return recorded(unit, images, parameters=parameters, timestamps=times)

    def _check(self, recording: Recording) -> list[int]:
        """Return the frames to keep and report the others; refuse a file that is unusable."""
        upright(np.zeros((1, 1), np.uint8), self.config.orientation or recording.orientation)
        names = {key for fields in recording.frames for key in fields if key.endswith("Transform")}
        if f"{self.config.transform}Transform" not in names:
            known = ", ".join(sorted(name.removesuffix("Transform") for name in names)) or "none"
            raise RacinesError(f"no transform {self.config.transform}; the file has {known}")
        for _ in read_frames(recording):
            pass  # a truncated file is found before anything is made of it
        kept: list[int] = []
        previous = -np.inf
        for index, fields in enumerate(recording.frames):
            if reason := self._wrong(fields, previous):
                self.report.append(Finding(recording.path.name, f"frame {index}", True, reason))
            else:
                previous = float(fields["Timestamp"])
                kept.append(index)
        if kept:
            self._check_unit(np.stack([self._matrix(recording.frames[i]) for i in kept]))
        self._flag_tools(recording)
        return kept

    def _wrong(self, fields: dict[str, str], previous: float) -> str:
        """Return why a frame cannot be used, or nothing."""
        name = f"{self.config.transform}Transform"
        for key in (f"{name}Status", "ImageStatus"):
            if fields.get(key, "OK") != "OK":
                return f"{key} is {fields[key]}"
        try:
            matrix, time = self._matrix(fields), float(fields["Timestamp"])
        except (KeyError, ValueError):
            return f"{name} or Timestamp is missing or not numbers"
        if not (np.isfinite(matrix).all() and np.isfinite(time)):
            return f"{name} or Timestamp is not finite"
        if fault := rotation_faults(matrix[None], self.config.tolerance)[0]:
            if fault.kind is Kind.REFLECTED:
                return f"{name} is left-handed: {fault.detail}"
            return f"{name} is not a rigid pose: {fault.detail}"
        if time <= previous:
            return f"Timestamp {time} does not follow {previous}"
        return ""

    def _check_unit(self, matrices: np.ndarray) -> None:
        reach = np.linalg.norm(matrices[:, :3, 3], axis=-1).max()
        if NEAREST <= reach <= FARTHEST:
            return
        size = reach / UNITS[self.config.unit]
        others = {name: metres for name, metres in LENGTHS.items() if name != self.config.unit}
        other = likely_unit(size, others, NEAREST, FARTHEST, _USUAL)
        read = f"translations reach {reach:.3g} m when read in {self.config.unit}"
        if other is None:
            raise RacinesError(f"{read}; give them in mm or m")
        remedy = f"set unit to {other}" if other in UNITS else "convert them to mm"
        raise RacinesError(f"{read}; they are likely in {other}: {remedy}")

    def _flag_tools(self, recording: Recording) -> None:
        own = f"{self.config.transform}TransformStatus"
        bad = Counter(
            key
            for fields in recording.frames
            for key, value in fields.items()
            if key.endswith("TransformStatus") and key != own and value != "OK"
        )
        for key, count in sorted(bad.items()):
            reason = f"not OK in {count} of {len(recording.frames)} frames; the frames are kept"
            self.report.append(Finding(recording.path.name, key, False, reason, count))

    def _matrix(self, fields: dict[str, str]) -> np.ndarray:
        """Return a frame's pose, (4, 4) float64, translation in metres."""
        numbers = [float(number) for number in fields[f"{self.config.transform}Transform"].split()]
        matrix = np.array(numbers).reshape(4, 4)
        matrix[:3, 3] *= UNITS[self.config.unit]
        return matrix


def _stem(path: Path) -> str:
    return path.name.removesuffix(".mha").removesuffix(".igs")
