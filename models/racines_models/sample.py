"""What generators are scored on: the same frames for all, and the images drawn of their poses."""

import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource, check_images
from racines_data.randomness import derive
from racines_data.store.frames import Batch, FrameStore
from racines_models.provenance import sha256_bytes

CHUNK = 64
"""Images asked of a generator at once."""
DRAW = 31
"""Random stream of the generators' seeds."""
FAINT = 1.0
"""An image whose gray levels have a smaller standard deviation shows nothing."""
FEW = 4
"""A set of images with fewer gray levels was scaled wrongly: 0-1 cast to uint8 leaves two, -1 to 1
leaves three. A poor generator that draws few levels is scored, not refused."""

Progress = Callable[[int], None]


@runtime_checkable
class FrameSource(Protocol):
    """Has images that were made beforehand, and finds them by the frame."""

    def draw_frames(self, frames: Batch, seed: int) -> Tensor:
        """Return the (N, 128, 128) uint8 images of N frames, drawn with one seed."""
        ...


@dataclass(frozen=True)
class Sample:
    """N frames of a split, spread over its trajectories."""

    frames: Batch
    trajectory: np.ndarray
    """(N,) the trajectory of each, an integer; of turns about the apex, the sector of 3°."""

    @property
    def digest(self) -> str:
        """Hash that says which frames these are."""
        return sha256_bytes(self.frames.index.numpy().tobytes())


def take_sample(store: FrameStore, split: str, size: int) -> Sample:
    """Take at most `size` frames at even distances, so that each trajectory has its share.

    Raises:
        RacinesError: the split has fewer than two frames.
    """
    rows = store.split_indices(split)
    if len(rows) < 2:
        few = f"split {split} has {len(rows)} frames"
        raise RacinesError(f"{few}: scores need 2 or more; set scores.split")
    return spread_sample(store, rows, size)


def evenly(count: int, wanted: int) -> Tensor:
    """Return `wanted` of `count` places, or all, at even distances; the first among them."""
    wanted = min(wanted, count)
    return torch.arange(wanted) * count // wanted


def spread_sample(store: FrameStore, rows: Tensor, size: int) -> Sample:
    """Take at most `size` of some rows at even distances, sweep after sweep."""
    rows = rows[torch.argsort(store.trajectory_index[rows], stable=True)]
    if len(rows) > size:
        rows = rows[(torch.arange(size) * len(rows) + len(rows) // 2) // size]
    if store.turns is not None:
        return Sample(store.take(rows), store.units(rows))
    return Sample(store.take(rows), store.trajectory_index[rows].numpy())


def draw(
    generator: ImageSource, frames: Batch, seed: int, progress: Progress | None = None
) -> Tensor:
    """Return the generator's (N, 128, 128) uint8 images of the frames' parameters.

    A frame's noise depends on `seed` and the frame's row, not on the frames beside it. A generator
    with a method `draw_frames(frames, seed)` is asked by it for all frames at once.

    Raises:
        RacinesError: an image is missing, of a wrong type, shape or range, or shows nothing.
    """
    if isinstance(generator, FrameSource):
        return check_drawn(generator.draw_frames(frames, seed))
    seeds = derive(torch.full_like(frames.index, seed), DRAW, frames.index)
    parts = []
    for parameters, chunk in zip(frames.parameters.split(CHUNK), seeds.split(CHUNK), strict=True):
        parts.append(drawn_of(generator, parameters, chunk))
        if progress is not None:
            progress(len(chunk))
    return check_drawn(torch.cat(parts))


def drawn_of(generator: ImageSource, parameters: Tensor, seeds: Tensor) -> Tensor:
    """Return a generator's images of (B, 12) parameters and (B,) seeds, on the CPU.

    Raises:
        RacinesError: it returned something else, or another number of images.
    """
    images = generator.generate(parameters, seeds)
    if not isinstance(images, Tensor) or len(images) != len(parameters):
        raise RacinesError(f"the generator returned no (B, H, W) tensor of {len(parameters)}")
    return images.cpu()


def check_drawn(images: Tensor) -> Tensor:
    """Return (N, 128, 128) uint8 images if they can be scored.

    Raises:
        RacinesError: NaN, wrong type, shape or range, or images that show nothing.
    """
    if images.is_floating_point() and not bool(images.isfinite().all()):
        raise RacinesError("images hold NaN or infinity: give uint8 gray levels 0-255")
    nothing = "nothing was drawn, or 0-1 images were cast to uint8"
    if images.dtype == torch.uint8 and images.numel() and int(images.max()) == 0:
        raise RacinesError(f"images are all black: {nothing}")
    check_images(images)
    spread = torch.cat([chunk.float().flatten(1).std(1) for chunk in images.split(CHUNK)])
    if float(spread.median()) < FAINT:
        faint = f"standard deviation below {FAINT:g} gray level"
        raise RacinesError(f"half of the images are near-constant ({faint}): {nothing}")
    levels = int(torch.bincount(images.flatten(), minlength=256).count_nonzero())
    if levels < FEW:
        raise RacinesError(
            f"images hold only {levels} gray levels: 0-1 or -1 to 1 images were cast to uint8; "
            "scale them to 0-255"
        )
    return images


def speed(generator: ImageSource, frames: Batch, batch: int, repeats: int = 5) -> float:
    """Return images a second at one batch size, the best of some calls."""
    rows = torch.arange(batch) % len(frames.index)
    parameters, seeds = frames.parameters[rows], torch.arange(batch)
    generator.generate(parameters, seeds)
    call = timeit.Timer(lambda: generator.generate(parameters, seeds).cpu())
    return batch / min(call.repeat(repeats, number=1))


def runs_of(generator: ImageSource | Sequence[ImageSource]) -> list[ImageSource]:
    """Return the trainings of a method: several, or the one that is given."""
    return list(generator) if isinstance(generator, Sequence) else [generator]
