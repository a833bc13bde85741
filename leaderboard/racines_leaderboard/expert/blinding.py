"""Names and files that tell nothing of an image: neither system nor view, nor what is a repeat."""

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from racines_data.files import write_atomic
from racines_leaderboard.expert.strata import allocate

DATE = 315_532_800
"""Time of every file: 1 January 1980, the earliest that archives can hold."""


@dataclass(frozen=True)
class Plan:
    """The names of M = images + repeats entries, and the blocks in which they are shown."""

    entries: np.ndarray
    """(M,) which image each entry shows; the repeats come last."""
    names: list[str]
    """(M,) the blind name of each entry."""
    blocks: list[list[str]]
    """Three blocks of sorted names. The two of a repeated image lie in the first and the last, so
    that at least the middle block lies between them, however each block is shuffled."""

    def named(self, answers: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Return the answer to each name, in order, with the name that it repeats."""
        images = len(answers)
        named = {}
        for place, (entry, name) in enumerate(zip(self.entries, self.names, strict=True)):
            first = self.names[entry] if place >= images else None
            named[name] = answers[entry] | {"repeat_of": first}
        return dict(sorted(named.items()))


def blind(systems: Sequence[str], repeats: int, rng: np.random.Generator) -> Plan:
    """Choose which of N images are repeated, as many of each system, and name all by chance.

    `repeats` is at most half of the images.
    """
    names = np.array(systems)
    present, counts = np.unique(names, return_counts=True)
    again = np.concatenate(
        [
            rng.permutation(np.flatnonzero(names == system))[:share]
            for system, share in zip(present, allocate(repeats, counts), strict=True)
        ]
    )
    total = len(names) + repeats
    numbers = rng.permutation(total) + 1
    width = max(4, len(str(total)))
    blind_names = [f"{number:0{width}d}" for number in numbers]
    twins = np.arange(len(names), total)
    # Which of the two comes in the first block is chance: the first is the one that is scored.
    swap = rng.random(repeats) < 0.5
    first, last = np.where(swap, twins, again), np.where(swap, again, twins)
    others = rng.permutation(np.setdiff1d(np.arange(len(names)), again))
    cut = np.array([total // 3 - repeats, total - 2 * (total // 3)]).cumsum()
    a, b, c = np.split(others, cut)
    blocks = [np.concatenate([first, a]), b, np.concatenate([last, c])]
    shown = [sorted(blind_names[entry] for entry in block) for block in blocks]
    return Plan(np.concatenate([np.arange(len(names)), again]), blind_names, shown)


def write_images(folder: Path, names: Sequence[str], images: np.ndarray) -> list[Path]:
    """Write (M, H, W) uint8 images as PNG files of one size and one date; return their paths.

    Uncompressed: the size of a compressed file would tell dark images from bright ones, and show
    which two are the same.
    """
    paths = []
    for name, image in sorted(zip(names, images, strict=True), key=lambda pair: pair[0]):
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG", compress_level=0)
        path = folder / f"{name}.png"
        write_atomic(path, buffer.getvalue())
        os.utime(path, (DATE, DATE))
        paths.append(path)
    return paths
