"""What of a stored image is echo: a rectangle, a sector; and how it lies."""

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.images import resolution, square
from racines_data.sources.table.mapping import Images, Sector
from racines_data.sources.tracked.source import upright


def check_region(images: Images, size: tuple[int, int]) -> None:
    """Refuse a crop or a sector that does not lie in images of this width and height."""
    width, height = size
    if images.crop is not None:
        left, top, right, bottom = images.crop
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            raise RacinesError(
                f"images.crop: {list(images.crop)}: left, top, right, bottom have to lie within "
                f"{resolution(size)} pixels, left before right and top before bottom"
            )
    if images.sector is not None:
        inner, outer = images.sector.radii
        first, last = images.sector.angles
        if not (0 <= inner < outer and -90 <= first < last <= 90):
            raise RacinesError(
                "images.sector: radii go from 0 or more to a larger one, angles from left to right "
                "within -90 to 90 degrees"
            )
        if not sector_mask(images.sector, size).any():
            raise RacinesError(
                f"images.sector: no pixel of {resolution(size)} lies in it; apex and radii are in "
                "pixels of the image as it is stored"
            )


def sector_mask(sector: Sector, size: tuple[int, int]) -> np.ndarray:
    """Return (height, width) whether a pixel lies in the sector."""
    x = np.arange(size[0])[None] - sector.apex[0]
    y = np.arange(size[1])[:, None] - sector.apex[1]
    radius, angle = np.hypot(x, y), np.degrees(np.arctan2(x, y))
    inside = (radius >= sector.radii[0]) & (radius <= sector.radii[1])
    return inside & (angle >= sector.angles[0]) & (angle <= sector.angles[1])


def finish(image: np.ndarray, images: Images, orientation: str) -> np.ndarray:
    """Return a stored (H, W) image as (128, 128): masked, cropped, upright, square."""
    if images.sector is not None:
        image = np.where(sector_mask(images.sector, (image.shape[1], image.shape[0])), image, 0)
    if images.crop is not None:
        left, top, right, bottom = images.crop
        image = image[top:bottom, left:right]
    return square(np.ascontiguousarray(upright(image, images.orientation or orientation)))
