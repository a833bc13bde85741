"""Strips of images for people to look at."""

from collections.abc import Sequence
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import pad

from racines_data.errors import RacinesError
from racines_data.files import image_bytes, write_atomic
from racines_data.views import RANDOM_LABEL

COLUMNS = 8


def write_strip(path: Path, rows: Sequence[Tensor], gap: int = 2) -> None:
    """Write a PNG of rows of (K, H, W) uint8 images, one below the other, all of one shape."""
    if len({tuple(row.shape) for row in rows}) != 1:
        raise RacinesError(f"{path}: rows of different shapes")
    tiles = pad(torch.stack(list(rows)), (0, gap, 0, gap), value=255)
    canvas = torch.cat([torch.cat(list(row), 1) for row in tiles])
    height, width = canvas.shape
    canvas = canvas[: height - gap, : width - gap].contiguous()
    write_atomic(path, image_bytes(Image.fromarray(canvas.numpy())))


def pick_columns(views: Tensor, grades: Tensor, random: int = RANDOM_LABEL) -> Tensor:
    """Choose up to 8 of (N,) frames: the best of each view, then others at even distances.

    `random` is the label of `Random`. Frames of unknown view (-1) are spread evenly.
    """
    chosen = []
    for label in range(random):
        rows = (views == label).nonzero()[:, 0]
        if len(rows):
            chosen.append(int(rows[grades[rows].nan_to_num(0.0).argmax()]))
    others = [i for i in range(len(views)) if i not in chosen]
    wanted = min(COLUMNS - len(chosen), len(others))
    chosen += [others[(2 * k + 1) * len(others) // (2 * wanted)] for k in range(wanted)]
    return torch.tensor(chosen[:COLUMNS])
