"""Image metrics: SSIM, MS-SSIM and PSNR per image, FID and KID of features."""

import functools
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_models.frechet import frechet_distance

DATA_RANGE = 255.0
"""Gray levels from black to white, for SSIM and PSNR."""
BORDER = 5
"""Pixels at each edge where the SSIM window is not whole; left out."""
SIGMA, K1, K2 = 1.5, 0.01, 0.03
"""Deviation of the SSIM window in pixels; the constants that keep its quotients finite."""
PSNR_CAP = 100.0
"""PSNR of identical images, dB, in place of infinity."""

SSIM_SETTINGS: dict[str, Any] = {
    "data_range": DATA_RANGE,
    "window": "Gaussian, 11x11, sigma 1.5",
    "k1": K1,
    "k2": K2,
    "border": f"{BORDER} pixels left out",
}
SCALES = (0.0448, 0.2856, 0.3001, 0.2363)
"""Weights of the first four scales of Wang et al., 2003, fine to coarse. The fifth would be 8 x 8
pixels at this image size, less than the 11 x 11 window."""
MS_SSIM_SETTINGS: dict[str, Any] = SSIM_SETTINGS | {
    "scales": len(SCALES),
    "weights": "the first four of Wang et al. 2003, divided by their sum",
    "between scales": "2 x 2 mean",
    "negative": "counts as 0",
    "border": f"{BORDER} pixels left out at each scale",
}
PSNR_SETTINGS: dict[str, Any] = {
    "data_range": DATA_RANGE,
    "average": "of per-image values",
    "cap_db": PSNR_CAP,
    "library": "torchmetrics",
}
KID_SETTINGS: dict[str, Any] = {
    "kernel": "(x.y/d + 1)^3",
    "estimator": "unbiased",
    "library": "torchmetrics",
}


def ssim(images: Tensor, truth: Tensor) -> Tensor:
    """Return the SSIM (Wang et al., 2004) of (N, H, W) uint8 image pairs, (N,) in [-1, 1]."""
    return _pairwise(lambda a, b: torch.mul(*_similarity(a, b)).mean((1, 2)), images, truth)


def ms_ssim(images: Tensor, truth: Tensor) -> Tensor:
    """Return the multi-scale SSIM of (N, H, W) uint8 image pairs, (N,) in [0, 1].

    Contrast and structure at each scale but the coarsest, SSIM there.

    Source: Wang et al., Multi-scale structural similarity for image quality assessment, 2003.
    """
    weights = [weight / sum(SCALES) for weight in SCALES]

    def chunk(a: Tensor, b: Tensor) -> Tensor:
        product = torch.ones(len(a), device=a.device)
        for weight in weights[:-1]:
            _, contrast = _similarity(a, b)
            product *= contrast.mean((1, 2)).clamp_min(0.0).pow(weight)
            a, b = (nn.functional.avg_pool2d(x, 2) for x in (a, b))
        coarsest = torch.mul(*_similarity(a, b)).mean((1, 2))
        return product * coarsest.clamp_min(0.0).pow(weights[-1])

    return _pairwise(chunk, images, truth)


def _similarity(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Return luminance, and contrast with structure, of (N, H, W) pairs at each whole window.

    The window is separable, so two products with a banded matrix do for a batch what a
    convolution of one channel takes twenty times as long for; and no border need be padded.
    """
    rows, columns = (_window(size).to(a.device) for size in a.shape[1:])
    moments = rows @ torch.stack([a, b, a * a, b * b, a * b]) @ columns.T
    mean_a, mean_b, square_a, square_b, product = moments
    both, squares = mean_a * mean_b, mean_a.square() + mean_b.square()
    variances = (square_a + square_b - squares).clamp_min(0.0)
    c1, c2 = (K1 * DATA_RANGE) ** 2, (K2 * DATA_RANGE) ** 2
    contrast = (2.0 * (product - both) + c2) / (variances + c2)
    return (2.0 * both + c1) / (squares + c1), contrast


@functools.lru_cache(maxsize=8)
def _window(size: int) -> Tensor:
    """Return the (size - 10, size) matrix that applies the Gaussian window along one axis."""
    place = torch.arange(-BORDER, BORDER + 1, dtype=torch.float64)
    weights = torch.exp(-0.5 * (place / SIGMA) ** 2)
    matrix = torch.zeros(size - 2 * BORDER, size, dtype=torch.float64)
    for row in range(len(matrix)):
        matrix[row, row : row + 2 * BORDER + 1] = weights / weights.sum()
    return matrix.float()


def psnr(images: Tensor, truth: Tensor) -> Tensor:
    """Return the PSNR of (N, H, W) uint8 image pairs, (N,) dB, at most `PSNR_CAP`."""
    from torchmetrics.functional.image import peak_signal_noise_ratio

    def chunk(a: Tensor, b: Tensor) -> Tensor:
        values = peak_signal_noise_ratio(a, b, data_range=DATA_RANGE, reduction="none", dim=(1, 2))
        return values.clamp_max(PSNR_CAP)

    return _pairwise(chunk, images, truth)


def fid(candidate: Tensor, reference: Tensor) -> float:
    """Return the Fréchet distance between (N, D) and (M, D) features; it falls with n."""
    return frechet_distance(reference, candidate)


def kid(
    candidate: Tensor, reference: Tensor, subset: int = 1000, subsets: int = 100, seed: int = 0
) -> float:
    """Return the kernel distance (Bińkowski et al., 2018) of two (N, D) feature sets.

    Up to `subset` samples enter one unbiased estimate over all pairs; more are drawn without
    replacement into `subsets` estimates, which are averaged.

    Raises:
        RacinesError: sets of different sizes, or fewer than two samples.
    """
    from torchmetrics.image.kid import poly_mmd

    n = len(candidate)
    if n != len(reference) or n < 2:
        raise RacinesError(f"KID needs two sets of one size >= 2, got {n} and {len(reference)}")
    x, y = reference.to(torch.float64), candidate.to(torch.float64)
    if n <= subset:
        return float(poly_mmd(x, y))
    generator = torch.Generator().manual_seed(seed)
    values = []
    for _ in range(subsets):
        i = torch.randperm(n, generator=generator)[:subset].to(x.device)
        j = torch.randperm(n, generator=generator)[:subset].to(x.device)
        values.append(float(poly_mmd(x[i], y[j])))
    return math.fsum(values) / subsets


class KernelMatrices:
    """The kernel within and between a true and a drawn set, so that the KID of subsets is cheap."""

    def __init__(self, truth: Tensor, drawn: Tensor):
        from torchmetrics.image.kid import poly_kernel

        x, y = truth.to(torch.float64), drawn.to(torch.float64)
        self._between = poly_kernel(x, y)
        self._within = poly_kernel(x, x) + poly_kernel(y, y)
        self._within.fill_diagonal_(0.0)

    def kid(self, keep: np.ndarray) -> float:
        """Return what `kid` returns of the samples that a (N,) mask keeps, over all pairs."""
        kept = torch.from_numpy(keep).to(self._within)
        n = float(kept.sum())
        within, between = (kept @ matrix @ kept for matrix in (self._within, self._between))
        return float(within / (n * (n - 1)) - 2.0 * between / n**2)


def _pairwise(metric: Any, images: Tensor, truth: Tensor, size: int = 256) -> Tensor:
    if images.shape != truth.shape:
        raise RacinesError(f"{tuple(images.shape)} images for {tuple(truth.shape)} true ones")
    parts = [
        metric(a.to(torch.float32), b.to(torch.float32))
        for a, b in zip(images.split(size), truth.split(size), strict=True)
    ]
    return torch.cat(parts) if parts else torch.empty(0)
