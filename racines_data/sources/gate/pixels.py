"""What the images of a trajectory say: scaled to 0-1, constant, frozen, inverted, turned."""

from collections.abc import Iterator

import numpy as np

from racines_data.imaging import IMAGE_SIZE
from racines_data.schema import Trajectory
from racines_data.sources.images import Fault, Kind

_FLAT = 2  # gray levels between the darkest and the brightest pixel of an image of nothing
_MOST = 0.5
_ONE, _ALL = 0.2, 0.95
"""Share of the pixels that one gray level has, and that it and black have, in a constant image."""
_STILL = 10  # frames of one image after which a moving probe should have changed it
_MOVED = 0.005, 0.087  # m, rad: half a centimetre, five degrees
_DARK, _WHITE = 8, 250  # gray levels of what is black, and of what is white
_ALWAYS = 0.2  # share of pixels that are white in every frame of no scanner's sector
_EDGE, _TIP, _STRAIGHT = 0.5, 0.4, 0.97
"""Of a sector seen from its tip: where it is widest, as a share of the depth, at least; the width
of its tip, as a share of the greatest, at most; how straight its edges are, a correlation."""
_SIDES = ("top", "bottom", "left", "right")


def shape_fault(images: np.ndarray) -> Fault | None:
    """Return why images are not (T, 128, 128) uint8, or None."""
    shape = (len(images), IMAGE_SIZE, IMAGE_SIZE)
    if images.dtype == np.uint8 and images.shape == shape and shape[0]:
        return None
    detail = f"images are {images.dtype} {images.shape}; "
    if images.dtype.kind == "f" and images.size and 0 <= images.min() <= images.max() <= 1:
        detail += "likely 0-1: multiply by 255 and round; "
    elif images.shape[:1] + images.shape[-2:] != shape and images.ndim == 4:
        detail += "likely with channels: turn them into one of gray; "
    detail += f"give uint8 (T, {IMAGE_SIZE}, {IMAGE_SIZE}), T > 0"
    return Fault(Kind.IMAGE_RANGE, detail, "image")


def pixel_faults(trajectory: Trajectory, poses: bool) -> Iterator[tuple[str, Fault]]:
    """Yield what is wrong with (T, 128, 128) uint8 images, with the name of the opinion, if one."""
    images = trajectory.images
    flat = images.reshape(len(images), -1)
    low, high = flat.min(1), flat.max(1)
    if high.max() <= 1:
        detail = (
            f"no pixel exceeds {high.max()}: likely 0-1 cast to integers; multiply by 255 first"
        )
        yield "", Fault(Kind.IMAGE_RANGE, detail, "image")
        return
    constant = (high.astype(int) - low <= _FLAT) | _one_gray(flat)
    if constant.mean() > _MOST:
        row = int(np.flatnonzero(constant)[0])
        detail = (
            f"{int(constant.sum())} of {len(constant)} frames are constant (frame {row}: gray "
            f"{low[row]}): no image is in them; give the frames as recorded"
        )
        yield "", Fault(Kind.CONSTANT, detail, "image")
        return
    yield from _frozen(trajectory, flat, poses)
    white = float((flat.min(0) >= _WHITE).mean())
    if white > _ALWAYS:
        detail = (
            f"{white:.0%} of the pixels are white in every frame: likely inverted (white where "
            "there is no echo), or scaled beyond 255; give echoes bright on black"
        )
        yield "saturated", Fault(Kind.IMAGE_RANGE, detail, "image")
    if (side := sector_side(images)) not in ("", "top"):
        detail = (
            f"the sector's tip is at the {side}: images are turned or transposed; give them with "
            "the probe at the top centre, (T, rows, columns)"
        )
        yield "sector", Fault(Kind.TURNED, detail, "image")


def _one_gray(flat: np.ndarray) -> np.ndarray:
    """Return (T,) whether an image is one gray, but for black (padding) and a few edges."""
    counts = np.stack([np.bincount(each, minlength=256) for each in flat]) / flat.shape[1]
    gray = counts[:, _DARK:].max(1)
    return (gray > _ONE) & (gray + counts[:, :_DARK].sum(1) > _ALL)


def _frozen(trajectory: Trajectory, flat: np.ndarray, poses: bool) -> Iterator[tuple[str, Fault]]:
    if len(flat) < 3:
        return
    same = (flat[1:] == flat[:-1]).all(1)
    if same.mean() > _MOST:
        detail = (
            f"{int(same.sum())} of {len(flat)} frames repeat the image before: frozen, or one "
            "image for many poses; give each frame its own image, or drop it"
        )
        yield "frozen", Fault(Kind.FROZEN, detail, "image")
        return
    if not poses:
        return
    ends = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    for start, stop in ends.reshape(-1, 2):
        pose = trajectory.parameters[start : stop + 1, 6:]
        moved = np.linalg.norm(pose[:, :3] - pose[0, :3], axis=-1).max()
        turned = np.abs(np.angle(np.exp(1j * (pose[:, 3:] - pose[0, 3:])))).max()
        if stop - start >= _STILL and (moved > _MOVED[0] or turned > _MOVED[1]):
            detail = (
                f"frames {start} to {stop} are one image while the probe moves {1000 * moved:.3g} "
                f"mm and turns {np.degrees(turned):.3g}°: frozen; drop the repeats"
            )
            yield "frozen", Fault(Kind.FROZEN, detail, "image")
            return


def sector_side(images: np.ndarray) -> str:
    """Return the side at which the tip of the sector is; nothing where no sector is to be seen.

    Images that fill their square (linear arrays, noise) or are cut off show none.
    """
    shown = images.max(0) > _DARK
    turned = (shown, shown[::-1], shown.T, shown.T[::-1])
    fits = [_is_fan(each) for each in turned]
    if fits[0] or sum(fits) != 1:
        return "top" if fits[0] else ""
    return _SIDES[fits.index(True)]


def _is_fan(shown: np.ndarray) -> bool:
    """Return whether what is shown widens in straight lines from its first row on."""
    rows = np.flatnonzero(shown.any(1))
    if len(rows) < IMAGE_SIZE // 4:
        return False
    part = shown[rows[0] : rows[-1] + 1]
    first = part.argmax(1)
    last = part.shape[1] - 1 - part[:, ::-1].argmax(1)
    width = np.where(part.any(1), last - first + 1, 0)
    widest = int(width.argmax())
    if width[0] > _TIP * width[widest] or widest < _EDGE * len(width):
        return False
    middle = (first + last)[: widest + 1] / 2
    centred = np.abs(middle - middle.mean()).mean() < 0.1 * width[widest]
    growth = np.corrcoef(np.arange(widest + 1), width[: widest + 1])[0, 1]
    return bool(centred and growth >= _STRAIGHT)
