"""The audit of leaks: held-out frames that are frames of an earlier split, however disguised.

    image ─> brightness 1 ─> bands of 2 to 8 pixels ─> minus their mean ─> 256 numbers ─> length 1

That is a frame's *texture*: the speckle, which no two scans share unless the probe is where it
was to a few tenths of a millimetre and degree, and little of the anatomy, which all of them share.
The *likeness* of two frames is the cosine of their textures, of one as it is and mirrored left to
right. Neither gain, JPEG, noise of some gray levels nor a new order of frames changes it much.

Two figures say of a held-out trajectory whether it leaks, besides equal pixels:

    copies    share of its frames that some frame of an earlier split is like by LIKENESS or more
    beside    share of its frames that frames of one trajectory of an earlier split are more like
              than the frames just before and after it in its own trajectory are

`beside` needs no threshold of likeness: a sweep's next frame was taken a moment later by the same
hand, so that a sweep to which another stays nearer than to itself is no other sweep. It finds what
`copies` cannot: a sweep of which every other frame is in training, and copies under heavy noise.
Frames of many sweeps lie near a frame of a densely scanned place, those of one only by chance.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.schema import SPLITS
from racines_data.store.frames import FrameStore

LIKENESS = 0.965
"""Likeness from which two frames show one place; scans of a pose reach 0.99, 1 mm apart 0.94."""
COPIES_LIMIT = 0.3
"""Largest share of copies in a trajectory of validation or test."""
BESIDE_LIMIT = 0.3
"""Largest share of frames that are nearer to one earlier trajectory than to their own."""
CHANCE = 4
"""So many frames of a trajectory may lie beside another, however short it is."""
RELATED = 0.5
"""Likeness below which a frame lies beside nothing: both may be noise."""
SIZE = 256
"""Numbers in a texture: a random projection, which keeps the cosine c to (1 - c²)/16."""
_FINE, _COARSE = 2, 8  # pixels: blocks whose means are kept, and blocks whose means are taken away
_GRAY = 32.0  # mean brightness that every image is brought to, gray levels
_AVERAGED = 4096  # frames of train, evenly spread, whose mean is taken away
_IMAGES, _QUERIES, _KEYS = 512, 1024, 32_768  # at a time; bounds the likenesses at 134 MB


@dataclass(frozen=True)
class SweepLeak:
    """How like a held-out trajectory is to the splits before its own."""

    trajectory: str
    split: str
    frames: int
    exact: int
    """Frames whose pixels, as they are or mirrored, are those of an earlier split's frame."""
    copies: float
    """Share of frames with a likeness of `LIKENESS` or more."""
    beside: float
    """Share of the frames that are nearer to one earlier trajectory than to their own."""
    mirrored: float
    """Share of frames that are most like a frame when mirrored."""
    likeness: float
    """Median of the greatest likeness of each frame."""
    source: str
    """The trajectory that most of the likest frames belong to."""
    from_source: float
    """Their share."""
    by_patient: bool = False
    """Whether splits are by patient: sweeps are then too quick for `beside`, which is told only.
    Likeness tells all the more: frames of two patients reach 0.6, where copies begin at 0.965."""

    @property
    def leaks(self) -> bool:
        """Whether a limit is passed."""
        beside = self.beside > BESIDE_LIMIT and round(self.beside * self.frames) > CHANCE
        beside = beside and not self.by_patient
        return self.exact > 0 or self.copies > COPIES_LIMIT or beside


class _Match(NamedTuple):
    likeness: Tensor  # (n,) float32, the greatest
    row: Tensor  # (n,) int64, of the store
    mirrored: Tensor  # (n,) bool


def find_leaks(
    store: FrameStore, progress: Callable[[int], object] | None = None
) -> list[SweepLeak]:
    """Compare each trajectory of validation and test with all frames of the splits before it.

    Validation is held against train, test against train and validation. `progress` is told of the
    frames that were read. Returns the trajectories in the dataset's order; none without train.
    """
    bounds = [store.bounds(split) for split in SPLITS]
    if bounds[0][0] == bounds[0][1]:
        return []
    mean = _mean_bands(store)
    plain, mirrored = _textures(store, mean, bounds[0][1], progress)
    found: list[SweepLeak] = []
    for split, (start, stop) in zip(SPLITS[1:], bounds[1:], strict=True):
        if start == stop:
            continue
        turned = mirrored[start - bounds[0][1] : stop - bounds[0][1]]
        match = _nearest(plain[start:stop], turned, plain[:start])
        exact = _exact(store, torch.arange(start, stop), match)
        own = _own_neighbour(plain[start:stop], store.trajectory_index[start:stop])
        found += _by_sweep(store, split, match, exact, own)
    return found


def check_patients(*stores: FrameStore) -> None:
    """Check that no patient is in two splits, of one config or of two.

    Raises:
        RacinesError: some are; the first is named with its splits.
    """
    seen: dict[int, str] = {}
    for store, split in product(stores, SPLITS):
        rows = store.trajectory_index[slice(*store.bounds(split))].unique().tolist()
        for patient in sorted({store.patients[row] for row in rows} if store.patients else ()):
            if seen.setdefault(patient, split) != split:
                own = "" if len(stores) == 1 else f" of {store.config}"
                raise RacinesError(
                    f"patient {patient} is in {seen[patient]} and in {split}{own}: keep patients "
                    "whole"
                )


def bands(images: Tensor) -> Tensor:
    """Return the (B, 64, 64) float32 bands of (B, 128, 128) uint8 images: 2 to 8 pixels wide."""
    pixels = images[:, None].float()
    pixels = pixels * (_GRAY / pixels.mean((2, 3), keepdim=True).clamp_min(1.0))
    coarse = functional.avg_pool2d(pixels, _COARSE)
    smooth = functional.interpolate(coarse, scale_factor=_COARSE // _FINE, mode="bilinear")
    return (functional.avg_pool2d(pixels, _FINE) - smooth)[:, 0]


@cache
def _projection() -> Tensor:
    numbers = (IMAGE_SIZE // _FINE) ** 2
    return torch.randn(numbers, SIZE, generator=torch.Generator().manual_seed(0))


def _mean_bands(store: FrameStore) -> Tensor:
    """Return the (64, 64) mean of the bands: what all images show, such as the sector's edge."""
    start, stop = store.bounds("train")
    count = min(stop - start, _AVERAGED)
    rows = start + torch.arange(count) * (stop - start) // count
    total = torch.zeros(IMAGE_SIZE // _FINE, IMAGE_SIZE // _FINE)
    for part in rows.split(_IMAGES):
        total += bands(store.images[part]).sum(0)
    return total / count


def _textures(
    store: FrameStore, mean: Tensor, first: int, progress: Callable[[int], object] | None
) -> tuple[Tensor, Tensor]:
    """Return (N, 256) textures, and those of the mirrored images from row `first` on."""
    plain, mirrored = torch.empty(len(store.images), SIZE), []
    for start in range(0, len(store.images), _IMAGES):
        found = bands(store.images[start : start + _IMAGES])
        rows = slice(start, start + len(found))
        plain[rows] = _project(found - mean)
        if rows.stop > first:  # the mean stays as it is: keys have it taken away unmirrored
            mirrored.append(_project(found[max(first - start, 0) :].flip(2) - mean))
        if progress is not None:
            progress(len(found))
    return plain, torch.cat(mirrored) if mirrored else plain[:0]


def _project(differences: Tensor) -> Tensor:
    return functional.normalize(differences.flatten(1) @ _projection(), dim=1)


def _nearest(plain: Tensor, mirrored: Tensor, keys: Tensor) -> _Match:
    """Return for each of (n, 256) textures the likest of (K, 256) keys, mirrored or not."""
    parts = []
    for queries in zip(plain.split(_QUERIES), mirrored.split(_QUERIES), strict=True):
        best = torch.full((2, len(queries[0])), -2.0)
        place = torch.zeros(best.shape, dtype=torch.int64)
        for start in range(0, len(keys), _KEYS):
            part = keys[start : start + _KEYS].T
            for way, query in enumerate(queries):
                likeness, at = (query @ part).max(1)
                better = likeness > best[way]
                best[way] = torch.where(better, likeness, best[way])
                place[way] = torch.where(better, at + start, place[way])
        flipped = best[1] > best[0]
        parts.append(_Match(best.amax(0), torch.where(flipped, place[1], place[0]), flipped))
    return _Match(*(torch.cat(each) for each in zip(*parts, strict=True)))


def _exact(store: FrameStore, rows: Tensor, match: _Match) -> Tensor:
    """Return (n,) bool: the pixels are those of the match, mirrored if that was likest."""
    same = match.likeness > 1 - 1e-4
    for place in same.nonzero()[:, 0].split(_IMAGES):
        asked, found = store.images[rows[place]], store.images[match.row[place]]
        turned = torch.where(match.mirrored[place, None, None], asked.flip(2), asked)
        same[place] = (turned == found).flatten(1).all(1)
    return same


def _own_neighbour(textures: Tensor, trajectory: Tensor) -> Tensor:
    """Return the (n,) greatest likeness to the frame before and after; infinite without either."""
    pairs = (textures[1:] * textures[:-1]).sum(1)
    pairs = torch.where(trajectory[1:] == trajectory[:-1], pairs, -torch.inf)
    none = torch.full((1,), -torch.inf)
    own = torch.maximum(torch.cat([none, pairs]), torch.cat([pairs, none]))
    return torch.where(own.isinf(), torch.inf, own)


def _by_sweep(
    store: FrameStore, split: str, match: _Match, exact: Tensor, own: Tensor
) -> list[SweepLeak]:
    start, stop = store.bounds(split)
    sources = store.trajectory_index[match.row]
    copies, nearer, paired = (
        match.likeness >= LIKENESS,
        match.likeness >= own.clamp_min(RELATED),
        own.isfinite(),
    )
    lengths = torch.unique_consecutive(store.trajectory_index[start:stop], return_counts=True)
    found = []
    edges = torch.cat([torch.zeros(1, dtype=torch.int64), lengths[1].cumsum(0)]).tolist()
    for index, (first, last) in zip(lengths[0].tolist(), pairwise(edges), strict=True):
        rows = slice(first, last)
        source, count = Counter(sources[rows].tolist()).most_common(1)[0]
        found.append(
            SweepLeak(
                trajectory=store.trajectories[index],
                split=split,
                frames=last - first,
                exact=int(exact[rows].sum()),
                copies=float(copies[rows].float().mean()),
                beside=_most(sources[rows][nearer[rows]]) / max(int(paired[rows].sum()), 1),
                mirrored=float(match.mirrored[rows].float().mean()),
                likeness=float(match.likeness[rows].median()),
                source=store.trajectories[source],
                from_source=count / (last - first),
                by_patient=store.patients is not None,
            )
        )
    return found


def _most(sources: Tensor) -> int:
    """Return how often the commonest of (n,) trajectories occurs."""
    return int(sources.bincount().amax()) if len(sources) else 0


def check_leaks(found: list[SweepLeak]) -> str:
    """Check that no trajectory leaks.

    Raises:
        RacinesError: some do; the first is named with its figures and where its frames are.
    """
    if not found:
        return "not told: train, or validation and test, have no frame"
    leaking = [sweep for sweep in found if sweep.leaks]
    limits = f"limits {COPIES_LIMIT:.0%} and {BESIDE_LIMIT:.0%}"
    if leaking:
        worst = max(leaking, key=lambda sweep: (sweep.exact > 0, sweep.copies, sweep.beside))
        more = f" (and {len(leaking) - 1} more trajectories)" if len(leaking) > 1 else ""
        raise RacinesError(
            f"trajectory {worst.trajectory} of {worst.split} leaks: {worst.copies:.0%} of its "
            f"{worst.frames} frames are copies ({worst.exact} exact), {worst.beside:.0%} nearer to "
            f"one earlier sweep than to their own; {limits}; most like {worst.source}{more}: "
            "take it, or what it was copied from, out of the dataset"
        )
    copies, beside = max(s.copies for s in found), max(s.beside for s in found)
    return (
        f"none of {len(found)} held-out trajectories leaks: at most {copies:.0%} of a trajectory's "
        f"frames are copies, {beside:.0%} nearer to one earlier sweep than to their own; "
        f"{limits}"
    )


def leaks_json(found: list[SweepLeak]) -> dict[str, Any]:
    """Return an audit as JSON: limits, and the figures of every held-out trajectory."""
    return {
        "limits": {"likeness": LIKENESS, "copies": COPIES_LIMIT, "beside": BESIDE_LIMIT},
        "leaking": [sweep.trajectory for sweep in found if sweep.leaks],
        "trajectories": [{**vars(sweep), "leaks": sweep.leaks} for sweep in found],
    }
