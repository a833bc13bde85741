"""How real the phantom looks: its A4C frames beside real ones, and real ones beside each other.

A distance to real frames means nothing alone. So each figure stands beside the same figure of two
halves of the real set, split by patient, at equal n: a perfect simulator would reach that.
"""

import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import MULTI_PHANTOM
from racines_data.store.frames import FrameStore
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, evenly
from racines_models.scores import metrics
from racines_models.scores.features import Extractor
from racines_models.studies.realism.patients import patients_of

SCHEMA = "racines.realism/1"
LEVELS = 256
DEPTHS, ANGLES = 3, 3
"""Cells of the sector, for histograms."""
RINGS = 16
"""Depth bins of the gray profile."""
WINDOW = 5
"""Edge of the window of local contrast, pixels."""


@dataclass(frozen=True)
class RealismConfig:
    """How the phantom's frames are held beside real ones."""

    real: str = ""
    """Parquet of real frames: columns `patient`, `image` (128 x 128 8-bit PNG)."""
    frames: int = 125
    """Frames of each set, fewer where there are fewer patients or frames."""
    view: str = "A4C"
    grade: float = 5.0
    """Frames of the view below this grade are left out: nobody would keep them."""
    splits: int = 20
    """Random halves of the real patients, one frame each; figures are means over them."""
    support: float = 0.9
    """A pixel is in the real sector if it is not black in this share of the real frames."""
    seed: int = 0


class RealFrames(NamedTuple):
    """Real frames for comparison."""

    images: Tensor
    """(N, 128, 128) uint8."""
    patient: np.ndarray
    """(N,) integer."""
    sha256: str
    chosen: str | None = None
    """Name of the list that the patients are of; None for all that the file has."""


class Simulated(NamedTuple):
    """Simulated frames for comparison."""

    images: Tensor
    """(N, 128, 128) uint8."""
    told: dict[str, Any]
    """What the report says of them: `config`, `phantom_hearts`, and `dataset` or `world`."""


class Realism(NamedTuple):
    """The report, and the frames it speaks of, as they were before masking."""

    content: dict[str, Any]
    real: Tensor
    phantom: Tensor


class Sector(NamedTuple):
    """The mask that both sets share, and where a pixel lies in it."""

    mask: Tensor
    """(H, W) bool."""
    ring: Tensor
    """(P,) int64 depth bin of each masked pixel, 0 at the apex."""
    cell: Tensor
    """(P,) int64 cell of each masked pixel."""

    @classmethod
    def of(cls, mask: Tensor) -> "Sector":
        """Lay rings and cells over a mask whose apex is at the top centre."""
        rows, columns = mask.nonzero().double().unbind(1)
        apex = rows.min() - 1.0
        x, y = columns - (mask.shape[1] - 1) / 2, rows - apex
        depth = x.hypot(y) / x.hypot(y).max()
        angle = torch.atan2(x, y)
        width = angle.abs().max() * 1.0001
        ring = (depth * RINGS).long().clamp_max(RINGS - 1)
        across = ((angle / width + 1.0) / 2.0 * ANGLES).long().clamp(0, ANGLES - 1)
        along = (depth * DEPTHS).long().clamp_max(DEPTHS - 1)
        return cls(mask, ring, along * ANGLES + across)


class Summary(NamedTuple):
    """What a set of N frames is reduced to, frame by frame, so that subsets are cheap."""

    histogram: Tensor
    """(N, cells, 256) pixels of each gray level."""
    profile: Tensor
    """(N, rings) mean gray by depth."""
    contrast: Tensor
    """(N, 256) pixels of each local standard deviation, gray levels."""
    features: Tensor
    """(N, D) Inception features of the masked frames."""

    @classmethod
    def of(cls, images: Tensor, sector: Sector, features: Tensor) -> "Summary":
        """Summarise (N, H, W) uint8 frames."""
        gray, cells = images[:, sector.mask].long(), DEPTHS * ANGLES
        histogram = _counts(sector.cell * LEVELS + gray, cells * LEVELS).view(-1, cells, LEVELS)
        rings = nn.functional.one_hot(sector.ring, RINGS).double()
        profile = gray.double() @ rings / rings.sum(0).clamp_min(1)
        contrast = _counts(local_deviation(images)[:, sector.mask].long(), LEVELS)
        return cls(histogram, profile, contrast, features)

    def take(self, rows: Tensor) -> "Summary":
        """Return the summary of some of the frames."""
        return Summary(*(each[rows] for each in self))


RULES = {
    "kid": "KID of Inception pool3 features, equal n",
    "fid": "FID of the same features, equal n; biased upwards at this n",
    "gray": "Wasserstein distance of gray-level histograms, gray levels",
    "gray_by_cell": "the same in each of 3 x 3 cells of the sector, mean over cells",
    "gray_by_depth": "root mean square difference of mean gray over 16 depths, gray levels",
    "local_contrast": "Wasserstein distance of 5 x 5 standard deviations, gray levels",
}


def differences(a: Summary, b: Summary) -> dict[str, float]:
    """Return the figures of `RULES` between two sets of equal size."""
    cells = [wasserstein(x, y) for x, y in zip(a.histogram.sum(0), b.histogram.sum(0), strict=True)]
    profile = (a.profile.mean(0) - b.profile.mean(0)).square().mean().sqrt()
    return {
        "kid": metrics.kid(a.features, b.features),
        "fid": metrics.fid(a.features, b.features),
        "gray": wasserstein(a.histogram.sum((0, 1)), b.histogram.sum((0, 1))),
        "gray_by_cell": sum(cells) / len(cells),
        "gray_by_depth": float(profile),
        "local_contrast": wasserstein(a.contrast.sum(0), b.contrast.sum(0)),
    }


def description(a: Summary) -> dict[str, Any]:
    """Return a set's mean and standard deviation of gray, and its mean gray by depth."""
    level = torch.arange(LEVELS, dtype=torch.float64)
    count = a.histogram.sum((0, 1)).double()
    share = count / count.sum()
    mean = float(share @ level)
    deviation = float((share @ (level - mean).square()).sqrt())
    profile = [round(float(value), 2) for value in a.profile.mean(0)]
    return {"mean": round(mean, 2), "std": round(deviation, 2), "by_depth": profile}


def wasserstein(a: Tensor, b: Tensor) -> float:
    """Return the Wasserstein-1 distance of two (K,) histograms over unit steps, in steps."""
    a, b = a.double() / a.sum().clamp_min(1), b.double() / b.sum().clamp_min(1)
    return float((a.cumsum(0) - b.cumsum(0)).abs().sum())


def local_deviation(images: Tensor, window: int = WINDOW) -> Tensor:
    """Return the standard deviation of (N, H, W) gray levels in windows, (N, H, W) float32."""
    x = images.unsqueeze(1).float()
    pool = nn.AvgPool2d(window, 1, window // 2, count_include_pad=False)
    mean, square = pool(x), pool(x * x)
    return (square - mean * mean).clamp_min(0.0).sqrt().squeeze(1)


def _counts(index: Tensor, size: int) -> Tensor:
    """Count (N, P) values below `size` in each row, (N, size)."""
    counts = torch.zeros(len(index), size, dtype=torch.int64)
    return counts.scatter_add_(1, index, torch.ones_like(index))


def read_real(path: Path, chosen: str | None = None) -> RealFrames:
    """Read real frames from a Parquet file, as `RealismConfig.real` describes it.

    With `chosen`, those of the patients of one list (see `patients`).
    """
    import polars as pl

    if not path.is_file():
        raise RacinesError(f"{path}: no such file; realism needs real frames, see docs/scores.md")
    try:
        table = pl.read_parquet(path, columns=["patient", "image"])
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RacinesError(f"{path}: no Parquet with columns patient and image: {error}") from error
    if chosen is not None:
        table = table.filter(pl.col("patient").cast(pl.String).is_in(sorted(patients_of(chosen))))
    if not len(table):
        told = "has no rows" if chosen is None else f"column patient has nobody of list {chosen}"
        raise RacinesError(f"{path}: {told}; name a file of real frames (docs/sim-to-real.md)")
    arrays = [np.asarray(Image.open(io.BytesIO(png)).convert("L")) for png in table["image"]]
    if any(array.shape != (IMAGE_SIZE, IMAGE_SIZE) for array in arrays):
        raise RacinesError(f"{path}: images are not all {IMAGE_SIZE} x {IMAGE_SIZE}")
    patient = np.unique(table["patient"].to_numpy(), return_inverse=True)[1]
    return RealFrames(torch.from_numpy(np.stack(arrays)), patient, sha256_file(path), chosen)


def choose_rows(store: FrameStore, config: RealismConfig) -> Tensor:
    """Return the (n,) rows of the frames of the view to compare, two or more, of all splits.

    Hearts have equal shares, as far as each has frames; the frames of one are at even distances.
    """
    if config.view not in store.labels:
        raise RacinesError(
            f"realism.view {config.view}: the dataset's views are {', '.join(store.labels)}; name "
            "no real frames where there are none of this organ (realism: {})"
        )
    of_view = store.views == store.labels.index(config.view)
    rows = (of_view & (store.grades >= config.grade)).nonzero()[:, 0]
    if len(rows) < 2:
        raise RacinesError(
            f"realism: {len(rows)} frames of {config.view} with grade >= {config.grade:g} in the "
            "dataset; lower realism.grade or build more frames"
        )
    return _spread(rows, _hearts(store)[rows], min(config.frames, len(rows)))


def _hearts(store: FrameStore) -> Tensor:
    """Return the (N,) int64 heart of each frame: the anatomy's seed, 0 in a set of one heart."""
    if store.config != MULTI_PHANTOM:
        return torch.zeros(len(store.views), dtype=torch.int64)
    seeds = torch.tensor([seed or 0 for seed in store.phantoms], dtype=torch.int64)
    return seeds[store.trajectory_index]


def _spread(rows: Tensor, heart: Tensor, count: int) -> Tensor:
    """Pick `count` of (R,) rows: from each heart as many, within a heart at even distances."""
    groups = [rows[heart == seed] for seed in heart.unique()]
    shares = torch.zeros(len(groups), dtype=torch.int64)
    sizes = torch.tensor([len(group) for group in groups])
    while (left := count - int(shares.sum())) > 0:
        open_ = (shares < sizes).nonzero()[:, 0]
        shares[open_[evenly(len(open_), left)]] += 1
    taken = zip(groups, shares.tolist(), strict=True)
    return torch.cat([group[evenly(len(group), share)] for group, share in taken if share])


def common_sector(real: Tensor, phantom: Tensor, support: float) -> Tensor:
    """Return the (H, W) mask of pixels in the sector of both sets.

    Real: not black in a share `support` of the frames, as scanners crop differently. Phantom: not
    black in any frame, as its sector is the same in all.
    """
    inside = ((real > 0).float().mean(0) >= support) & (phantom > 0).any(0)
    if int(inside.sum()) < 1000:
        raise RacinesError("realism: the sectors of real and phantom frames do not overlap")
    return inside


def not_compared(config: str, reason: str) -> dict[str, Any]:
    """Return the report on a config of which there is nothing to compare."""
    return {"schema": SCHEMA, "compared": False, "config": config, "reason": reason}


def of_store(store: FrameStore, config: RealismConfig) -> Simulated:
    """Take the frames of a dataset that `choose_rows` picks."""
    rows = choose_rows(store, config)
    told = {
        "config": store.config,
        "dataset": dataset_card(store) | {"digest": store.digest},
        "phantom_hearts": len(_hearts(store)[rows].unique()),
    }
    return Simulated(store.take(rows).images, told)


def compare_with_real(
    real: RealFrames,
    simulated: Simulated,
    config: RealismConfig,
    extractor: Extractor,
    progress: Progress | None = None,
) -> Realism:
    """Hold simulated frames beside the real ones."""
    began = time.perf_counter()
    phantom, real = simulated.images, one_each(real, 2 * config.frames)
    mask = common_sector(real.images, phantom, config.support)
    sector = Sector.of(mask)
    ours, theirs = (images * mask for images in (phantom, real.images))
    a, b = (Summary.of(images, sector, extractor(images, progress)) for images in (ours, theirs))
    n, figures = _over_splits(a, b, config)
    content = {
        "schema": SCHEMA,
        "compared": True,
        **simulated.told,
        "real": {"sha256": real.sha256, "frames": len(theirs), "patients": len(set(real.patient))}
        | ({"list": real.chosen} if real.chosen else {}),
        "view": config.view,
        "grade_at_least": config.grade,
        "phantom_frames": len(ours),
        "n": n,
        "splits": config.splits,
        "mask": {"pixels": int(mask.sum()), "support": config.support},
        "figures": figures,
        "gray": {"phantom": description(a), "real": description(b)},
        "extractor": extractor.settings,
        "code": code_version(),
        "environment": environment(),
        "seconds": round(time.perf_counter() - began, 3),
    }
    return Realism(content, real.images, phantom)


def one_each(real: RealFrames, count: int) -> RealFrames:
    """Keep one frame a patient, the phase by turns, of at most `count` patients."""
    order = np.argsort(real.patient, kind="stable")
    patient, first, frames = np.unique(real.patient[order], return_index=True, return_counts=True)
    rows = order[first + np.arange(len(patient)) % frames][evenly(len(patient), count)]
    images = real.images[torch.from_numpy(rows)]
    return RealFrames(images, real.patient[rows], real.sha256, real.chosen)


def _over_splits(
    phantom: Summary, real: Summary, config: RealismConfig
) -> tuple[int, dict[str, Any]]:
    """Return n, and each figure's mean and range over random halves of the patients."""
    random = np.random.default_rng(config.seed)
    n = min(len(phantom.profile), len(real.profile) // 2, config.frames)
    rows: dict[str, list[dict[str, float]]] = {"phantom": [], "real": []}
    for _ in range(config.splits):
        order = torch.from_numpy(random.permutation(len(real.profile)))
        one, other = real.take(order[:n]), real.take(order[n : 2 * n])
        ours = phantom.take(torch.from_numpy(random.permutation(len(phantom.profile))[:n]))
        rows["phantom"].append(differences(ours, one))
        rows["real"].append(differences(other, one))
    figures: dict[str, Any] = {name: {"rule": rule} for name, rule in RULES.items()}
    for name, figure in figures.items():
        for key, found in rows.items():
            figure[key] = metrics.over_splits([each[name] for each in found])
    return n, figures
