"""How much the images of one pose differ, beside how much the scanner itself makes them differ."""

from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.phantom.config import recorded_phantom
from racines_data.store.frames import Batch, FrameStore
from racines_models.sample import draw
from racines_models.scores.features import kept

FRAMES = 64
"""Poses drawn again where one seed was asked for, and poses scanned again."""


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

    The sets are those drawn of all frames; of a single one, some frames are drawn once more. None
    where that is impossible, since the images were made beforehand.
    """
    if len(drawn) > 1:
        return drawn, torch.arange(len(drawn[0]))
    if not hasattr(generator, "generate"):
        return None
    places = places_again(len(drawn[0]))
    some = Batch(*(column[places] for column in frames))
    return [drawn[0][places], draw(generator, some, seeds[0] + 1)], places


def places_again(count: int) -> Tensor:
    """Return the places of at most 64 of `count` frames, at even distances."""
    wanted = min(FRAMES, count)
    return torch.arange(wanted) * count // wanted


def scanned_again(store: FrameStore, frames: Batch, folder: Path | None = None) -> Tensor | None:
    """Return the (N,) `spread` of two new scans at the frames' poses; None if there is no scanner.

    Only a simulated phantom can be scanned again; `folder` keeps the figures between runs.
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
