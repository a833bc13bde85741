"""PNG images of strangers: looked at before they are decoded, and decoded within bounds."""

import io
import struct

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.sources.images import check_png

MAX_PNG = 2**16
"""Most bytes of one image; 128 × 128 gray levels without compression are 16.6 kB."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
MODES = {0: "gray", 2: "RGB", 3: "palette", 4: "gray with alpha", 6: "RGBA"}


def decode_gray(data: bytes, where: str) -> np.ndarray:
    """Return the (128, 128) uint8 gray levels of an 8-bit gray PNG.

    Raises:
        RacinesError: no such PNG, too large, truncated or damaged; begins with `where`.
    """
    _check_header(data, where)
    try:
        check_png(data)
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            # A second header further on could change what the first one said.
            if image.size != (IMAGE_SIZE, IMAGE_SIZE) or image.mode != "L":
                raise RacinesError(f"damaged PNG: it says {image.size} behind its header")
            return np.asarray(image)
    except Exception as error:
        raise RacinesError(f"{where}: {error}: write the image again") from error


def _check_header(data: bytes, where: str) -> None:
    if len(data) > MAX_PNG:
        raise RacinesError(f"{where}: {len(data):,} bytes: a PNG has at most {MAX_PNG:,}")
    if len(data) < 33 or data[:8] != SIGNATURE or data[12:16] != b"IHDR":
        raise RacinesError(f"{where}: not a PNG: give the bytes of an 8-bit gray PNG")
    width, height, bits, color = struct.unpack(">IIBB", data[16:26])
    if (width, height) != (IMAGE_SIZE, IMAGE_SIZE):
        raise RacinesError(f"{where}: {width} x {height} pixels: give {IMAGE_SIZE} x {IMAGE_SIZE}")
    if (bits, color) != (8, 0):
        mode = MODES.get(color, f"colour type {color}")
        raise RacinesError(f"{where}: {bits}-bit {mode}: give 8-bit gray (mode L)")
