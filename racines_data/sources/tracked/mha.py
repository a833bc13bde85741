"""Reading PLUS sequence files (`.igs.mha`): a text header, then 8-bit frames, often zlib-packed.

Format: PLUS applications user manual, "Sequence file" and "Ultrasound image orientation".

    ObjectType = Image                    Seq_Frame0000_ProbeToTrackerTransform = 16 numbers, rows
    DimSize = width height frames         Seq_Frame0000_ProbeToTrackerTransformStatus = OK
    UltrasoundImageOrientation = MFA      Seq_Frame0000_Timestamp = 214.9
    …                                     ElementDataFile = LOCAL <newline> data
"""

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError

_FRAME = re.compile(r"Seq_Frame(\d+)_(\w+)")
_CHUNK = 1 << 20
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
        for line in iter(file.readline, b""):
            key, equals, value = line.decode("latin-1").partition("=")
            key, value = key.strip(), value.strip()
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
