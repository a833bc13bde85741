"""The Fréchet distance between Gaussians fitted to two sets of features, in float64.

d² = |m₁ - m₂|² + tr Σ₁ + tr Σ₂ - 2 tr (Σ₁^½ Σ₂ Σ₁^½)^½ (Dowson and Landau, 1982; Heusel et al.,
2017). The usual code takes the root of the non-symmetric product Σ₁Σ₂. Here the root of the
reference is taken once and kept; the rest is the eigenvalues of a symmetric matrix. With fewer
samples than dimensions the same trace is the nuclear norm of the cross-Gram matrix X₁X₂ᵀ, exact
for singular covariances and far smaller.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from racines_data.errors import RacinesError


@dataclass(frozen=True)
class Reference:
    """The Gaussian of a reference set, with the symmetric root of its covariance."""

    mean: Tensor
    """(D,) float64."""
    root: Tensor
    """(D, D) float64, symmetric, positive semidefinite."""
    trace: float
    """Trace of the covariance."""
    n: int

    @classmethod
    def of(cls, features: Tensor) -> "Reference":
        """Fit (N, D) features."""
        mean, covariance = moments(features)
        return cls(mean, symmetric_root(covariance), float(covariance.trace()), len(features))

    def distance(self, features: Tensor) -> float:
        """Return the Fréchet distance to (M, D) features."""
        mean, covariance = moments(features)
        product = self.root @ covariance @ self.root
        eigenvalues = torch.linalg.eigvalsh((product + product.T) / 2)
        shift = (self.mean - mean).square().sum()
        return float(shift + self.trace + covariance.trace() - 2 * _root(eigenvalues).sum())


def frechet_distance(reference: Tensor, candidate: Tensor) -> float:
    """Return the Fréchet distance between (N, D) and (M, D) features.

    Raises:
        RacinesError: fewer than two samples, or features that are not finite.
    """
    for features in (reference, candidate):
        if len(features) < 2:
            raise RacinesError(f"a Fréchet distance needs 2 images or more, got {len(features)}")
    if min(len(reference), len(candidate)) > reference.shape[1]:
        return Reference.of(reference).distance(candidate)
    return _distance_by_gram(reference, candidate)


def moments(features: Tensor) -> tuple[Tensor, Tensor]:
    """Return the (D,) mean and the unbiased (D, D) covariance of (N, D) features, float64."""
    x = _checked(features)
    mean = x.mean(0)
    centred = x - mean
    return mean, centred.T @ centred / (len(x) - 1)


def symmetric_root(matrix: Tensor) -> Tensor:
    """Return the positive semidefinite root of a symmetric positive semidefinite matrix."""
    eigenvalues, vectors = torch.linalg.eigh(matrix)
    return (vectors * _root(eigenvalues)) @ vectors.T


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
