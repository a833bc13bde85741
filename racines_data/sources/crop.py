"""Finding the ultrasound sector on a scanner's screen: what varies is image, what stays is not."""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

Box = tuple[int, int, int, int]
"""Left, top, right, bottom: pixels, the last two past the end."""

_MOVES = 4.0
"""Standard deviation over images above which a pixel belongs to the sector, gray levels."""
_DARK = 8
_FEWEST = 8
_SMALLEST = 0.02


def sector_box(images: Sequence[np.ndarray]) -> Box:
    """Return the box of the sector in (H, W) uint8 images of one screen layout.

    Logos, scales and text are the same in every image and drop out, however bright; so does what
    is black. The largest connected region that is left is the sector. With fewer than eight images
    it is the largest region that is not black in their mean. A screen without such a region is
    returned whole.
    """
    stack = np.stack(images).astype(np.float32)
    height, width = stack.shape[1:]
    lively = stack.std(0) > _MOVES if len(stack) >= _FEWEST else stack.mean(0) > _DARK
    # Opening cuts ticks and text that touch the sector; closing joins speckle to one region.
    region = ndimage.binary_closing(lively, np.ones((5, 5), bool), border_value=0) | lively
    region = ndimage.binary_opening(region, np.ones((7, 7), bool))
    labels = np.empty(region.shape, np.int32)
    ndimage.label(region, output=labels)
    sizes = np.bincount(labels.ravel())[1:]
    if not len(sizes) or sizes.max() < _SMALLEST * height * width:
        return 0, 0, width, height
    rows, columns = ndimage.find_objects(labels)[int(sizes.argmax())]
    return int(columns.start), int(rows.start), int(columns.stop), int(rows.stop)
