"""How much drawn images differ: among those of one pose, and from the training images.

Images of one pose stand beside what the scanner itself makes of it. Whether images are copies is
told by how far the nearest training image lies: candidates are found by 8 x 8-pixel means, a
16 x 16 picture, and the nearest of them is then decided by the whole images. A generator that has
learned the scene is as far from the training set as true held-out frames are; one that repeats what
it saw is nearer.
"""

from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.phantom.config import recorded_phantom
from racines_data.store.frames import Batch, FrameStore
from racines_models.sample import draw, evenly
from racines_models.scores.features import kept

FRAMES = 64
"""Poses drawn again where one seed was asked for, and poses scanned again."""
BLOCK = 8
"""Pixels a side over which the search averages."""
CANDIDATES = 8
"""Training images compared in full with each drawn one."""
COPY = 2.0
"""An image that differs from a training image by less (root mean square, gray levels) copies it."""
READ = 4096
"""Training images averaged at a time."""
QUERIES = 256
"""Images looked up at a time."""


def spread(draws: list[Tensor]) -> Tensor:
    """Return the (N,) root-mean-square gray-level difference between two draws of one pose.

    `draws` are two or more (N, H, W) uint8 sets; the squares are averaged over all pairs of them.
    """
    squares = [(a.float() - b.float()).square().mean((1, 2)) for a, b in combinations(draws, 2)]
    return torch.stack(squares).mean(0).sqrt()


def drawn_again(
    generator: ImageSource, frames: Batch, drawn: list[Tensor], seeds: tuple[int, ...]
) -> tuple[list[Tensor], Tensor] | None:
    """Return two or more sets of images of the same poses, and the (n,) places of their frames.

    Of a single set, some frames are drawn once more; None if images were made beforehand.
    """
    if len(drawn) > 1:
        return drawn, torch.arange(len(drawn[0]))
    if not hasattr(generator, "generate"):
        return None
    places = evenly(len(drawn[0]), FRAMES)
    some = Batch(*(column[places] for column in frames))
    return [drawn[0][places], draw(generator, some, seeds[0] + 1)], places


def scanned_again(store: FrameStore, frames: Batch, folder: Path | None = None) -> Tensor | None:
    """Return the (N,) `spread` of two new scans at the frames' poses; None but for a phantom.

    `folder` keeps the figures between runs.
    """
    try:
        config = recorded_phantom(store.manifest)
    except RacinesError:
        return None

    def make() -> Tensor:
        from racines_data.phantom.model import shared_phantom

        phantom = shared_phantom(config, "cpu")
        return spread([draw(phantom, frames, seed) for seed in (0, 1)])

    rows = frames.index.tolist()
    return kept(folder, ["scanned again", store.manifest["recipe_digest"], rows], make)


def summarise(images: Tensor) -> Tensor:
    """Return the (N, 256) float32 block means of (N, 128, 128) uint8 images."""
    parts = [functional.avg_pool2d(x.unsqueeze(1).float(), BLOCK) for x in images.split(READ)]
    return torch.cat(parts).flatten(1)


def summarise_train(store: FrameStore) -> Tensor:
    """Return the (N, 256) block means of the train split, in order of its rows."""
    rows = store.split_indices("train")
    return torch.cat([summarise(store.take(part).images) for part in rows.split(READ)])


def nearest_train(images: Tensor, store: FrameStore, summaries: Tensor) -> Tensor:
    """Return the (N,) root-mean-square gray-level difference to the nearest training image.

    `images` are (N, 128, 128) uint8, `summaries` what `summarise_train` returns of the store.
    """
    rows, found = store.split_indices("train"), []
    for batch in images.split(QUERIES):
        distance = torch.cdist(summarise(batch), summaries.float())
        nearest = distance.topk(min(CANDIDATES, len(rows)), largest=False).indices
        candidates = store.take(rows[nearest.flatten()]).images.view(*nearest.shape, -1)
        flat = batch.flatten(1).float()
        apart = [(flat - each.float()).square().mean(1).sqrt() for each in candidates.unbind(1)]
        found.append(torch.stack(apart, 1).amin(1))
    return torch.cat(found)
