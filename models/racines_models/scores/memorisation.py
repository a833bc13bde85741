"""Whether drawn images are copies: how far the nearest training image lies.

Candidates are found by 8 x 8-pixel means, a 16 x 16 picture; the nearest of them is then decided by
the whole images. A generator that has learned the scene is as far from the training set as true
held-out frames are; one that repeats what it saw is nearer.
"""

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.store.frames import FrameStore

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


def summarise(images: Tensor) -> Tensor:
    """Return the (N, 256) float32 block means of (N, 128, 128) uint8 images."""
    parts = [functional.avg_pool2d(x.unsqueeze(1).float(), BLOCK) for x in images.split(READ)]
    return torch.cat(parts).flatten(1) if parts else torch.empty(0, 256)


def summarise_train(store: FrameStore) -> Tensor:
    """Return the (N, 256) block means of the train split, in order of its rows."""
    rows = store.split_indices("train")
    return torch.cat([summarise(store.take(part).images) for part in rows.split(READ)])


def nearest_train(images: Tensor, store: FrameStore, summaries: Tensor) -> Tensor:
    """Return the (N,) root-mean-square gray-level difference to the nearest training image.

    Args:
        images: (N, 128, 128) uint8.
        store: The dataset.
        summaries: What `summarise_train` returns of it.
    """
    rows, found = store.split_indices("train"), []
    for batch in images.split(QUERIES):
        distance = torch.cdist(summarise(batch), summaries.float())
        nearest = distance.topk(min(CANDIDATES, len(rows)), largest=False).indices
        candidates = store.take(rows[nearest.flatten()]).images.view(*nearest.shape, -1)
        found.append(_differences(batch, candidates).amin(1))
    return torch.cat(found) if found else torch.empty(0)


def _differences(images: Tensor, candidates: Tensor) -> Tensor:
    """Return the (B, C) differences of (B, H, W) images from their (B, C, H·W) candidates."""
    columns = [
        (images.flatten(1).float() - candidates[:, c].float()).square().mean(1).sqrt()
        for c in range(candidates.shape[1])
    ]
    return torch.stack(columns, 1)
