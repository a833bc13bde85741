"""Image metrics: SSIM, MS-SSIM and PSNR per image (torchmetrics); FID, KID and PRDC of features.

PRDC is precision, recall, density and coverage of a set, by nearest neighbours of features.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_models.networks.batching import SIZE

DATA_RANGE = 255.0
"""Gray levels from black to white, for SSIM and PSNR."""
BORDER = 5
"""Pixels at each edge where the SSIM window is not whole; left out."""
PSNR_CAP = 100.0
"""PSNR of identical images, dB, in place of infinity."""

SSIM_SETTINGS: dict[str, Any] = {
    "data_range": DATA_RANGE,
    "window": "Gaussian, 11x11, sigma 1.5",
    "k1": 0.01,
    "k2": 0.03,
    "border": f"{BORDER} pixels left out",
    "library": "torchmetrics",
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
NEIGHBOURS = 5
"""k of PRDC: a ball around a sample reaches its k-th nearest neighbour in its own set."""
ROWS = 512
"""Rows of a distance matrix made at a time."""
PRDC_SETTINGS: dict[str, Any] = {"k": NEIGHBOURS, "distance": "Euclidean"}


def ssim(images: Tensor, truth: Tensor) -> Tensor:
    """Return the SSIM (Wang et al., 2004) of (N, H, W) uint8 image pairs, (N,) in [-1, 1]."""
    return _pairwise(ssim_of, images, truth)


def ssim_of(a: Tensor, b: Tensor) -> Tensor:
    """Return the SSIM of (N, 1, H, W) float image pairs of gray levels, (N,)."""
    full = _similarity(a, b, return_full_image=True)
    # torchmetrics averages over its reflected border too; the definition does not.
    return full[..., BORDER:-BORDER, BORDER:-BORDER].mean((1, 2, 3))


def _similarity(a: Tensor, b: Tensor, **wanted: bool) -> Tensor:
    from torchmetrics.functional.image import structural_similarity_index_measure as measure

    # On a CPU a few images fit its caches, and take half the time of many.
    size = SIZE.get(a.device.type, len(a) or 1)
    parts = [
        measure(x, y, data_range=DATA_RANGE, reduction="none", **wanted)[1]
        for x, y in zip(a.split(size), b.split(size), strict=True)
    ]
    return torch.cat(parts)


def ms_ssim(images: Tensor, truth: Tensor) -> Tensor:
    """Return the multi-scale SSIM of (N, H, W) uint8 image pairs, (N,) in [0, 1].

    Contrast and structure at each scale but the coarsest, SSIM there; torchmetrics' own function
    averages the latter over its reflected border, which is most of a 16 x 16 image.

    Source: Wang et al., Multi-scale structural similarity for image quality assessment, 2003.
    """
    weights = torch.tensor(SCALES) / sum(SCALES)

    def chunk(a: Tensor, b: Tensor) -> Tensor:
        product = torch.ones(len(a), device=a.device)
        for weight in weights[:-1].tolist():
            contrast = _similarity(a, b, return_contrast_sensitivity=True)
            product *= contrast.clamp_min(0.0).pow(weight)
            a, b = (nn.functional.avg_pool2d(x, 2) for x in (a, b))
        return product * ssim_of(a, b).clamp_min(0.0).pow(float(weights[-1]))

    return _pairwise(chunk, images, truth)


def psnr(images: Tensor, truth: Tensor) -> Tensor:
    """Return the PSNR of (N, H, W) uint8 image pairs, (N,) dB, at most `PSNR_CAP`."""
    from torchmetrics.functional.image import peak_signal_noise_ratio as ratio

    each = partial(ratio, data_range=DATA_RANGE, reduction="none", dim=(1, 2, 3))
    return _pairwise(each, images, truth).clamp_max(PSNR_CAP)


def fid(candidate: Tensor, reference: Tensor) -> float:
    """Return the Fréchet distance between (N, D) and (M, D) features; it falls with n."""
    return frechet_distance(reference, candidate)


def frechet_distance(reference: Tensor, candidate: Tensor) -> float:
    """Return the Fréchet distance between Gaussians fitted to (N, D) and (M, D) features, float64.

    d² = |m₁ - m₂|² + tr Σ₁ + tr Σ₂ - 2 tr (Σ₁^½ Σ₂ Σ₁^½)^½ (Dowson and Landau, 1982; Heusel et al.,
    2017). The usual code takes the root of the non-symmetric product Σ₁Σ₂; the eigenvalues of a
    symmetric matrix take its place here. With fewer samples than dimensions the same trace is the
    nuclear norm of the cross-Gram matrix X₁X₂ᵀ, exact for singular covariances and far smaller.
    Sets of one sample, and features that are not finite, are refused.
    """
    for features in (reference, candidate):
        if len(features) < 2:
            raise RacinesError(f"a Fréchet distance needs 2 images or more, got {len(features)}")
    if min(len(reference), len(candidate)) > reference.shape[1]:
        return _distance_by_covariance(reference, candidate)
    return _distance_by_gram(reference, candidate)


def _distance_by_covariance(reference: Tensor, candidate: Tensor) -> float:
    (mean, covariance), (other, its) = moments(reference), moments(candidate)
    eigenvalues, vectors = torch.linalg.eigh(covariance)
    root = (vectors * _root(eigenvalues)) @ vectors.T
    product = root @ its @ root
    eigenvalues = torch.linalg.eigvalsh((product + product.T) / 2)
    shift, traces = (mean - other).square().sum(), (covariance.trace(), its.trace())
    return float(shift + traces[0] + traces[1] - 2 * _root(eigenvalues).sum())


def moments(features: Tensor) -> tuple[Tensor, Tensor]:
    """Return the (D,) mean and the unbiased (D, D) covariance of (N, D) features, float64."""
    x = _checked(features)
    mean = x.mean(0)
    centred = x - mean
    return mean, centred.T @ centred / (len(x) - 1)


def _root(eigenvalues: Tensor) -> Tensor:
    # Eigenvalues at the level of rounding are zeros of a singular matrix: their roots, about
    # 1e-8 each, would add up over thousands of dimensions.
    noise = eigenvalues.max().clamp_min(0) * len(eigenvalues) * torch.finfo(torch.float64).eps
    return torch.where(eigenvalues > noise, eigenvalues, 0.0).sqrt()


def _distance_by_gram(reference: Tensor, candidate: Tensor) -> float:
    x, y = _checked(reference), _checked(candidate)
    shift = (x.mean(0) - y.mean(0)).square().sum()
    x = (x - x.mean(0)) / (len(x) - 1) ** 0.5
    y = (y - y.mean(0)) / (len(y) - 1) ** 0.5
    nuclear = torch.linalg.svdvals(x @ y.T).sum()
    return float(shift + x.square().sum() + y.square().sum() - 2 * nuclear)


def _checked(features: Tensor) -> Tensor:
    if not bool(torch.isfinite(features).all()):
        raise RacinesError("features are not finite: an extractor met broken images")
    return features.to(torch.float64)


def kid(
    candidate: Tensor, reference: Tensor, subset: int = 1000, subsets: int = 100, seed: int = 0
) -> float:
    """Return the kernel distance (Bińkowski et al., 2018) of two (N, D) feature sets, N >= 2.

    Up to `subset` samples enter one unbiased estimate over all pairs; more are drawn without
    replacement into `subsets` estimates, which are averaged.
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


class CrossProducts:
    """The products of a true and a drawn set, so that the Fréchet distance of subsets is cheap."""

    def __init__(self, truth: Tensor, drawn: Tensor):
        self._sets, self._product = (truth, drawn), None
        if len(truth) == len(drawn) <= truth.shape[1]:
            # About a point that both are near to: nothing is lost when a subset's mean goes.
            x, y = _checked(truth), _checked(drawn)
            self._sets = x - x.mean(0), y - x.mean(0)
            self._squares = [each.square().sum(1) for each in self._sets]
            self._product = self._sets[0] @ self._sets[1].T

    def fid(self, keep: np.ndarray) -> float:
        """Return what `frechet_distance` returns of the samples that a (N,) mask keeps."""
        rows = torch.from_numpy(np.flatnonzero(keep))
        kept = [each[rows] for each in self._sets]
        n = len(rows)
        if self._product is None or n < 2:
            return frechet_distance(*kept)
        means = [each.mean(0) for each in kept]
        traces = [
            squares[rows].sum() - n * mean.square().sum()
            for squares, mean in zip(self._squares, means, strict=True)
        ]
        product = self._product[rows][:, rows]
        product = product - product.mean(0) - product.mean(1, keepdim=True) + product.mean()
        nuclear = torch.linalg.svdvals(product).sum()
        shift = (means[0] - means[1]).square().sum()
        return float(shift + (traces[0] + traces[1] - 2 * nuclear) / (n - 1))


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


class Neighbourhoods:
    """The distances within and between a true and a drawn set, so that subsets are cheap.

    Precision and recall: Kynkäänniemi et al., Improved Precision and Recall Metric for Assessing
    Generative Models, 2019. Density and coverage: Naeem et al., Reliable Fidelity and Diversity
    Metrics for Generative Models, 2020.
    """

    def __init__(self, truth: Tensor, drawn: Tensor, k: int = NEIGHBOURS):
        if len(truth) != len(drawn) or len(truth) <= k:
            raise RacinesError(
                f"PRDC with k = {k} needs two sets of one size > {k}, got {len(truth)} and "
                f"{len(drawn)}; raise scores.samples"
            )
        self._k = k
        self._matrices = _within(truth), _within(drawn), distances(truth, drawn)

    def figures(self, keep: np.ndarray | None = None) -> dict[str, float]:
        """Return the four figures of all samples, or of those that a (N,) mask keeps."""
        truth, drawn, between = self._matrices
        if keep is not None and not keep.all():
            rows = torch.from_numpy(np.flatnonzero(keep))
            truth, drawn, between = (each[rows][:, rows] for each in self._matrices)
        k = min(self._k, len(truth) - 1)
        true_radius, drawn_radius = (each.kthvalue(k, 1).values for each in (truth, drawn))
        in_true_ball = between <= true_radius.unsqueeze(1)
        return {
            "precision": float(in_true_ball.any(0).double().mean()),
            "recall": float((between <= drawn_radius).any(1).double().mean()),
            "density": float(in_true_ball.double().sum(0).mean() / k),
            "coverage": float((between.amin(1) <= true_radius).double().mean()),
        }


def distances(a: Tensor, b: Tensor) -> Tensor:
    """Return the (N, M) float32 distances between (N, D) and (M, D) features, N in batches."""
    b = b.double()
    return torch.cat([torch.cdist(rows.double(), b).float() for rows in a.split(ROWS)])


def _within(features: Tensor) -> Tensor:
    # A sample is no neighbour of its own; copies of it are.
    return distances(features, features).fill_diagonal_(torch.inf)


def over_splits(values: list[float]) -> dict[str, float]:
    """Return mean and range of a figure over random splits, as JSON."""
    return {"value": float(np.mean(values)), "low": min(values), "high": max(values)}


def _pairwise(
    metric: Callable[[Tensor, Tensor], Tensor], images: Tensor, truth: Tensor, size: int = 256
) -> Tensor:
    if images.shape != truth.shape:
        raise RacinesError(f"{tuple(images.shape)} images for {tuple(truth.shape)} true ones")
    parts = [
        metric(a.unsqueeze(1).to(torch.float32), b.unsqueeze(1).to(torch.float32)).reshape(-1)
        for a, b in zip(images.split(size), truth.split(size), strict=True)
    ]
    return torch.cat(parts) if parts else torch.empty(0)
