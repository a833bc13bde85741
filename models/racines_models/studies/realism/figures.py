"""Figures of how two sets of ultrasound frames differ, within one sector mask."""

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from racines_models.scores import metrics

LEVELS = 256
DEPTHS, ANGLES = 3, 3
"""Cells of the sector, for histograms."""
RINGS = 16
"""Depth bins of the gray profile."""
WINDOW = 5
"""Edge of the window of local contrast, pixels."""


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
        gray = images[:, sector.mask].long()
        cells = DEPTHS * ANGLES
        index = sector.cell * LEVELS + gray
        histogram = _counts(index, cells * LEVELS).view(-1, cells, LEVELS)
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
