"""The pictures of patients that the documentation shows: a sheet of six, and each view beating.

python -m tests.data.patients.pictures      # writes docs/assets
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from racines_data.geometry import Pose
from racines_data.patients import Pool
from racines_data.plotting import letters, mark_depth

FOLDER = Path(__file__).parents[3] / "docs" / "assets"
SHEET = tuple(range(10_000, 10_006))
BEATING = 10_003
"""A validation patient whose hearts are shown beating."""
SCALE, FRAMES, SECONDS = 2, 20, 0.05
SIDE = 128 * SCALE


def at_targets(pool: Pool, rows: torch.Tensor, views: torch.Tensor) -> Pose:
    """Return the nominal poses of rows' patients at a view each."""
    every, each = pool.targets(rows), torch.arange(len(rows))
    return Pose(every.position[each, views], every.rotation[each, views])


def enlarged(image: np.ndarray) -> Image.Image:
    """Return a gray picture at `SCALE`."""
    size = (image.shape[1] * SCALE, image.shape[0] * SCALE)
    return Image.fromarray(image).resize(size, Image.Resampling.BICUBIC)


def marked(image: np.ndarray, name: str, mm: float) -> Image.Image:
    """Return a picture enlarged to pixels of `mm`, with its view and cm of depth."""
    whole = enlarged(image)
    mark_depth(whole, mm)
    ImageDraw.Draw(whole).text((8, 6), name, 255, letters(18))
    return whole


def sheet(pool: Pool) -> Image.Image:
    """Draw each patient, a row, in each view."""
    views = torch.arange(len(pool.views)).repeat(len(pool))
    rows = torch.arange(len(pool)).repeat_interleave(len(pool.views))
    images = pool.render(at_targets(pool, rows, views), rows, None, torch.arange(len(rows)))
    scale = (pool.pixel_size(rows) / SCALE).tolist()
    whole = Image.new("L", (len(pool.views) * SIDE, len(pool) * SIDE))
    for at, image in enumerate(images.numpy()):
        row, view = divmod(at, len(pool.views))
        whole.paste(marked(image, pool.views[view], scale[at]), (view * SIDE, row * SIDE))
    return whole


def beat(pool: Pool, view: int) -> list[Image.Image]:
    """Draw one view over one beat, the breath held."""
    rows = torch.zeros(FRAMES, dtype=torch.int64)
    phase = torch.stack([torch.arange(FRAMES) / FRAMES, torch.zeros(FRAMES)], 1).double()
    pose = at_targets(pool, rows, torch.full((FRAMES,), view))
    images = pool.render(pose, rows, phase, torch.arange(FRAMES))
    mm = float(pool.pixel_size(rows[:1])) / SCALE
    return [marked(image, pool.views[view], mm) for image in images.numpy()]


def main() -> None:
    """Write the pictures."""
    sheet(Pool(SHEET)).save(FOLDER / "patients.png", optimize=True)
    pool = Pool([BEATING], beating=True)
    for row, view in enumerate(pool.views):
        first, *others = beat(pool, row)
        path = FOLDER / f"{view.lower()}-beating.gif"
        milliseconds = round(1000 * SECONDS)
        first.save(path, save_all=True, append_images=others, duration=milliseconds, loop=0)


if __name__ == "__main__":
    main()
