"""The pictures of patients that the documentation shows: a sheet of six, and each view beating.

python -m tests.data.patients.pictures      # writes docs/assets
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from racines_data.geometry import Pose
from racines_data.patients import Pool

FOLDER = Path(__file__).parents[3] / "docs" / "assets"
SHEET = tuple(range(10_000, 10_006))
BEATING = 10_003
"""A validation patient whose hearts are shown beating."""
SCALE, FRAMES, SECONDS = 2, 20, 0.05


def at_targets(pool: Pool, rows: torch.Tensor, views: torch.Tensor) -> Pose:
    """Return the nominal poses of rows' patients at a view each."""
    every, each = pool.targets(rows), torch.arange(len(rows))
    return Pose(every.position[each, views], every.rotation[each, views])


def enlarged(image: np.ndarray) -> Image.Image:
    """Return a gray picture at `SCALE`."""
    size = (image.shape[1] * SCALE, image.shape[0] * SCALE)
    return Image.fromarray(image).resize(size, Image.Resampling.BICUBIC)


def sheet(pool: Pool) -> Image.Image:
    """Draw each patient, a row, in each view."""
    views = torch.arange(len(pool.views)).repeat(len(pool))
    rows = torch.arange(len(pool)).repeat_interleave(len(pool.views))
    images = pool.render(at_targets(pool, rows, views), rows, None, torch.arange(len(rows)))
    images = images.view(len(pool), -1, 128, 128).permute(0, 2, 1, 3)
    return enlarged(images.reshape(len(pool) * 128, -1).numpy())


def beat(pool: Pool, view: int) -> list[Image.Image]:
    """Draw one view over one beat, the breath held."""
    rows = torch.zeros(FRAMES, dtype=torch.int64)
    phase = torch.stack([torch.arange(FRAMES) / FRAMES, torch.zeros(FRAMES)], 1).double()
    pose = at_targets(pool, rows, torch.full((FRAMES,), view))
    images = pool.render(pose, rows, phase, torch.arange(FRAMES))
    return [enlarged(image) for image in images.numpy()]


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
