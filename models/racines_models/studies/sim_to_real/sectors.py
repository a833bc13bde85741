"""How real pictures lie in their square: screens cut away, stretched masks put right."""

import numpy as np
import torch
from PIL import Image, ImageDraw
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from racines_data.imaging import IMAGE_SIZE

DARK = 2
"""Gray levels up to this are the screen's black."""
COLOURED = 40
"""Difference of a pixel's channels from which on it is the scanner's graphics, not echo."""
THIN, OPENED = 7, 5
"""Pixels: the window of a median that takes text and ticks away, and of what is left of a bar."""
NEAR = 0.03
"""Parts of a sector lie apart where blood is black, by less than this share of the width."""
SMALLEST = 200
"""Pixels of such a part."""


def hull(lit: np.ndarray) -> np.ndarray:
    """Return the (H, W) bool convex hull of the lit pixels: a sector is convex, its blood black."""
    points = np.argwhere(lit)
    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # fewer than three pixels, or all in a line
        return lit
    canvas = Image.new("1", (lit.shape[1], lit.shape[0]))
    ImageDraw.Draw(canvas).polygon([(int(x), int(y)) for y, x in corners], fill=1, outline=1)
    return np.asarray(canvas, bool)


def parts(lit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (H, W) numbers of connected parts, from 1 on, and the (K,) pixels of each."""
    number = np.empty(lit.shape, np.int32)
    ndimage.label(lit, output=number)
    return number, np.bincount(number.ravel())[1:]


def sectors(images: Tensor) -> Tensor:
    """Return the (N, H, W) bool sectors of uint8 frames that have nothing but a sector."""
    return torch.from_numpy(np.stack([hull(image > 0) for image in images.numpy()]))


def crop_screen(picture: Image.Image) -> np.ndarray:
    """Return the (128, 128) uint8 frame in a scanner's screen, laid out as CAMUS's are.

    The largest lit region with what is near it is the sector; its bounding box is padded to a
    square, the apex at the top, and resampled by Lanczos.
    """
    colours = np.asarray(picture.convert("RGB")).astype(int)
    gray = np.asarray(picture.convert("L")).copy()
    gray[colours.max(-1) - colours.min(-1) > COLOURED] = 0
    inside = _sector(gray)
    if not inside.any():
        return laid_out(gray)
    rows, columns = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    cut = (gray * inside)[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return laid_out(cut)


def _sector(gray: np.ndarray) -> np.ndarray:
    """Return the (H, W) bool sector in a screen of gray levels."""
    lit = ndimage.median_filter(gray, THIN) > DARK
    number, sizes = parts(ndimage.binary_opening(lit, np.ones((OPENED, OPENED))))
    if not len(sizes):
        return np.zeros_like(lit)
    largest, *others = (1 + np.argsort(-sizes)).tolist()
    inside = hull(number == largest)
    for each in others:
        if sizes[each - 1] < SMALLEST:
            break
        part = number == each
        apart = np.asarray(ndimage.distance_transform_edt(~inside))
        if apart[part].min() < NEAR * gray.shape[1]:
            inside = hull(inside | part)
    return inside


def laid_out(gray: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8 padded to a square, at the top in the middle, as 128 x 128."""
    height, width = gray.shape
    side = max(height, width)
    square = Image.new("L", (side, side))
    square.paste(Image.fromarray(gray), ((side - width) // 2, 0))
    return np.asarray(square.resize((IMAGE_SIZE, IMAGE_SIZE), Image.Resampling.LANCZOS))


def are_stretched(masks: Tensor, aspect: np.ndarray) -> bool:
    """Return whether masks fill a square that their frames were padded to.

    They do where one reaches into its frame's padding, in which nobody can have drawn.

    Args:
        masks: (M, H, W) uint8.
        aspect: (M,) height by width of the frames before they were padded, NaN where unknown.
    """
    rows = torch.arange(masks.shape[1]).expand(len(masks), -1)
    end = masks.shape[1] * torch.from_numpy(np.nan_to_num(aspect, nan=1.0)).unsqueeze(1)
    return bool(((rows > end + 1) & (masks > 0).any(2)).any())


def unstretched(masks: Tensor, aspect: np.ndarray) -> Tensor:
    """Return (M, H, W) masks that were stretched to the square as if they had been padded to it."""
    size = masks.shape[1]
    place = np.arange(size) + 0.5
    out = torch.zeros_like(masks)
    for mask, ratio, put in zip(masks, np.nan_to_num(aspect, nan=1.0), out, strict=True):
        rows = place / min(ratio, 1.0)
        columns = (place - size / 2) * max(ratio, 1.0) + size / 2
        inside = np.outer(rows < size, (columns >= 0) & (columns < size))
        down, across = (np.clip(each.astype(int), 0, size - 1) for each in (rows, columns))
        put.copy_(torch.from_numpy(mask.numpy()[np.ix_(down, across)] * inside))
    return out
