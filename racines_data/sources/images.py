"""Other people's image files: is a file whole, and how it becomes a 128×128 gray image."""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_MOST_PIXELS = 64_000_000
_GRAY_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX")


class DamagedImage(RacinesError):
    """An image file that cannot be used; `kind` is one of `not a PNG`, `truncated PNG`, …."""

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"{kind}: {detail}")
        self.kind, self.detail = kind, detail


def check_png(content: bytes) -> tuple[int, int]:
    """Return width and height of a PNG that is whole: every chunk, its CRC, and all pixels.

    Nothing is decoded, so that a large import is checked before any work is done.

    Raises:
        DamagedImage: it is not a PNG, is truncated or damaged, or has 16 bits a channel.
    """
    if not content or _SIGNATURE.startswith(content):
        raise DamagedImage("truncated PNG", f"it ends after {len(content)} bytes")
    if not content.startswith(_SIGNATURE):
        raise DamagedImage("not a PNG", f"it begins with {content[:8]!r}")
    packed: list[bytes] = []
    position, header = len(_SIGNATURE), None
    while True:
        kind, body, position = _chunk(content, position)
        if header is None:
            header = _header(kind, body)
        elif kind == b"IDAT":
            packed.append(body)
        elif kind == b"IEND":
            break
    width, height, row, interlaced = header
    _check_pixels(b"".join(packed), height * row, interlaced)
    return width, height


def _chunk(content: bytes, position: int) -> tuple[bytes, bytes, int]:
    head = position + 8
    if head > len(content):
        raise DamagedImage("truncated PNG", f"it ends after {len(content)} bytes")
    length, kind = struct.unpack_from(">I4s", content, position)
    end = head + length
    if end + 4 > len(content):
        raise DamagedImage("truncated PNG", f"it ends after {len(content)} bytes")
    (crc,) = struct.unpack_from(">I", content, end)
    if zlib.crc32(memoryview(content)[position + 4 : end]) != crc:
        raise DamagedImage("damaged PNG", f"the checksum of its {kind!r} chunk is wrong")
    return kind, content[head:end], end + 4


def _header(kind: bytes, body: bytes) -> tuple[int, int, int, bool]:
    """Return width, height, bytes of a row with its filter, and whether it is interlaced."""
    if kind != b"IHDR" or len(body) != 13:
        raise DamagedImage("damaged PNG", "it does not begin with a header")
    width, height, bits, colour, _, _, interlace = struct.unpack(">IIBBBBB", body)
    if colour not in _CHANNELS or not 0 < width * height <= _MOST_PIXELS:
        raise DamagedImage("damaged PNG", f"{width}×{height} pixels of colour type {colour}")
    if bits > 8:
        raise DamagedImage("unreadable image", f"{bits} bits a channel; save it with 8")
    return width, height, 1 + (width * bits * _CHANNELS[colour] + 7) // 8, bool(interlace)


def _check_pixels(packed: bytes, size: int, interlaced: bool) -> None:
    unpacker = zlib.decompressobj()
    try:
        found = len(unpacker.decompress(packed, 2 * size))
    except zlib.error as error:
        raise DamagedImage("damaged PNG", f"its pixels cannot be unpacked ({error})") from error
    if found < size or (not interlaced and (found > size or not unpacker.eof)):
        raise DamagedImage("truncated PNG", f"{found} bytes of pixels instead of {size}")


def read_gray(path: Path, box: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Return an image file as (H, W) uint8 gray; `box` crops it: left, top, right, bottom.

    Raises:
        RacinesError: the file cannot be read, or is not an 8-bit image.
    """
    try:
        with Image.open(path) as image:
            if image.mode not in _GRAY_MODES:
                raise RacinesError(f"{path}: {image.mode} pixels; save it with 8 bits a channel")
            plain = image.convert("RGB") if image.mode in ("P", "PA", "RGBA") else image
            gray = plain.convert("L")
            return np.asarray(gray.crop(box) if box else gray)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise RacinesError(f"{path}: cannot be read ({error}); import again") from error


def square(image: np.ndarray) -> np.ndarray:
    """Return an upright (H, W) uint8 image as (128, 128): padded to a square, then Lanczos.

    Padding goes to both sides, or to the bottom, so that the probe stays at the top centre. An
    image of 128×128 is returned as it is.
    """
    height, width = image.shape
    size = max(height, width)
    padded = np.zeros((size, size), np.uint8)
    left = (size - width) // 2
    padded[:height, left : left + width] = image
    if size == IMAGE_SIZE:
        return padded
    resized = Image.fromarray(padded).resize((IMAGE_SIZE, IMAGE_SIZE), Image.Resampling.LANCZOS)
    return np.asarray(resized)


def check_jpeg(content: bytes) -> tuple[int, int]:
    """Return width and height of a JPEG that is whole; it is decoded at an eighth of its size.

    Raises:
        DamagedImage: it is not a JPEG, or is truncated or damaged.
    """
    if not content:
        raise DamagedImage("truncated JPEG", "it is empty")
    if not content.startswith(b"\xff\xd8"):
        raise DamagedImage("not a JPEG", f"it begins with {content[:8]!r}")
    try:
        with Image.open(io.BytesIO(content)) as image:
            size = image.size
            image.draft("L", (1, 1))
            image.load()
    except (OSError, SyntaxError, ValueError) as error:
        kind = "truncated JPEG" if "truncated" in f"{error}" else "damaged JPEG"
        raise DamagedImage(kind, f"{error}") from error
    return size
