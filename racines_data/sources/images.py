"""Other people's files: what is wrong with them, and how images become 128×128 gray ones."""

import io
import struct
import zlib
from enum import StrEnum
from pathlib import Path

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_MOST_PIXELS = 64_000_000
_GRAY_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX")


class Kind(StrEnum):
    """What is wrong; every reason in the report begins with one of these and a colon."""

    MISSING_LOG = "missing log"
    MISSING_IMAGE = "missing image"
    MISSING_ROW = "missing row"
    MISSING_TABLE = "missing table"
    TRUNCATED_PNG = "truncated PNG"
    NOT_A_PNG = "not a PNG"
    DAMAGED_PNG = "damaged PNG"
    TRUNCATED_JPEG = "truncated JPEG"
    NOT_A_JPEG = "not a JPEG"
    DAMAGED_JPEG = "damaged JPEG"
    UNREADABLE_IMAGE = "unreadable image"
    MIXED_SIZES = "mixed sizes"
    UNREADABLE_LOG = "unreadable log"
    WRONG_SHAPE = "wrong matrix shape"
    NAN = "NaN"
    INFINITE = "infinite"
    REFLECTED = "reflected rotation"
    NOT_ORTHONORMAL = "non-orthonormal rotation"
    NOT_RIGID = "not a rigid pose"
    TRANSPOSED = "transposed rotation"
    DEGREES = "degrees"
    LOOKS_UP = "looks up"
    MILLIMETRES = "millimetres"
    CENTIMETRES = "centimetres"
    METRES = "metres"
    OUT_OF_REACH = "out of reach"
    MIXED_UNITS = "mixed units"
    FORCE_UNIT = "unit of force"
    FORCE_SIGN = "sign of force"
    CONTROL_UNIT = "unit of velocity"
    CLOCK = "clock"
    IMAGE_RANGE = "range of gray"
    CONSTANT = "constant image"
    FROZEN = "frozen"
    TURNED = "turned image"
    GRADE_CONFLICT = "grade conflict"
    WRONG_GRADE = "wrong grade"
    DUPLICATE_NUMBER = "duplicate number"
    GAP = "gap in numbers"
    EMPTY_FOLDER = "empty folder"
    UNKNOWN = "unknown file"
    ORDER = "order of images"
    SPLIT = "splits by turn"
    SCALE = "unknown scale"
    PHASE = "phases of the beat"


class Fault(RacinesError):
    """Why a file, or the `item` of it, cannot be used."""

    def __init__(self, kind: Kind, detail: str, item: str = "") -> None:
        super().__init__(f"{kind}: {item}: {detail}" if item else f"{kind}: {detail}")
        self.kind, self.detail, self.item = kind, detail, item


def resolution(size: tuple[int, int]) -> str:
    """Return width and height as they are written."""
    return f"{size[0]}×{size[1]}"


def check_png(content: bytes) -> tuple[int, int]:
    """Return width and height of a PNG that is whole: every chunk, its CRC, and all pixels.

    Nothing is decoded, so that a large import is checked before any work is done.

    Raises:
        Fault: it is not a PNG, is truncated or damaged, or has 16 bits a channel.
    """
    if not content or _SIGNATURE.startswith(content):
        raise Fault(Kind.TRUNCATED_PNG, f"it ends after {len(content)} bytes")
    if not content.startswith(_SIGNATURE):
        raise Fault(Kind.NOT_A_PNG, f"it begins with {content[:8]!r}")
    kind, body, position = _chunk(content, len(_SIGNATURE))
    width, height, row, interlaced = _header(kind, body)
    packed = bytearray()
    while kind != b"IEND":
        kind, body, position = _chunk(content, position)
        if kind == b"IDAT":
            packed += body
    size, unpacker = height * row, zlib.decompressobj()
    try:
        found = len(unpacker.decompress(packed, 2 * size))
    except zlib.error as error:
        raise Fault(Kind.DAMAGED_PNG, f"its pixels cannot be unpacked ({error})") from error
    if found < size or (not interlaced and (found > size or not unpacker.eof)):
        raise Fault(Kind.TRUNCATED_PNG, f"{found} bytes of pixels instead of {size}")
    return width, height


def _chunk(content: bytes, position: int) -> tuple[bytes, bytes, int]:
    """Return a chunk's kind, its content, and where the next one begins."""
    head = position + 8
    kind = content[position + 4 : head]
    end = head + int.from_bytes(content[position : position + 4])
    if end + 4 > len(content):
        raise Fault(Kind.TRUNCATED_PNG, f"it ends after {len(content)} bytes")
    crc = int.from_bytes(content[end : end + 4])
    if zlib.crc32(memoryview(content)[position + 4 : end]) != crc:
        raise Fault(Kind.DAMAGED_PNG, f"the checksum of its {kind!r} chunk is wrong")
    return kind, content[head:end], end + 4


def _header(kind: bytes, body: bytes) -> tuple[int, int, int, bool]:
    """Return width, height, bytes of a row with its filter, and whether it is interlaced."""
    if kind != b"IHDR" or len(body) != 13:
        raise Fault(Kind.DAMAGED_PNG, "it does not begin with a header")
    width, height, bits, colour, _, _, interlace = struct.unpack(">IIBBBBB", body)
    if colour not in _CHANNELS or not 0 < width * height <= _MOST_PIXELS:
        raise Fault(Kind.DAMAGED_PNG, f"{width}×{height} pixels of colour type {colour}")
    if bits > 8:
        raise Fault(Kind.UNREADABLE_IMAGE, f"{bits} bits a channel; save it with 8")
    return width, height, 1 + (width * bits * _CHANNELS[colour] + 7) // 8, bool(interlace)


def read_gray(path: Path) -> np.ndarray:
    """Return an image file as (H, W) uint8 gray.

    Raises:
        RacinesError: the file cannot be read, or is not an 8-bit image.
    """
    try:
        with Image.open(path) as image:
            if image.mode not in _GRAY_MODES:
                raise RacinesError(f"{path}: {image.mode} pixels; save it with 8 bits a channel")
            plain = image.convert("RGB") if image.mode in ("P", "PA", "RGBA") else image
            return np.asarray(plain.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise RacinesError(f"{path}: cannot be read ({error}); import again") from error


def square(image: np.ndarray) -> np.ndarray:
    """Return an upright (H, W) uint8 image as (128, 128): padded to a square, then Lanczos.

    Padding goes to both sides, or to the bottom, so that the probe stays at the top centre. An
    image of 128×128 is returned as it is.
    """
    height, width = image.shape
    size = max(height, width)
    left = (size - width) // 2
    padded = np.pad(image, ((0, size - height), (left, size - width - left)))
    if size == IMAGE_SIZE:
        return padded
    resized = Image.fromarray(padded).resize((IMAGE_SIZE, IMAGE_SIZE), Image.Resampling.LANCZOS)
    return np.asarray(resized)


def check_jpeg(content: bytes) -> tuple[int, int]:
    """Return width and height of a JPEG that is whole; it is decoded at an eighth of its size.

    Raises:
        Fault: it is not a JPEG, or is truncated or damaged.
    """
    if not content:
        raise Fault(Kind.TRUNCATED_JPEG, "it is empty")
    if not content.startswith(b"\xff\xd8"):
        raise Fault(Kind.NOT_A_JPEG, f"it begins with {content[:8]!r}")
    try:
        with Image.open(io.BytesIO(content)) as image:
            size = image.size
            image.draft("L", (1, 1))
            image.load()
    except (OSError, SyntaxError, ValueError) as error:
        kind = Kind.TRUNCATED_JPEG if "truncated" in f"{error}" else Kind.DAMAGED_JPEG
        raise Fault(kind, f"{error}") from error
    return size
