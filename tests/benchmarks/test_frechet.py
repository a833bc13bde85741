"""Speed of the Fréchet distance, beside the formula of the usual code and torchmetrics.

The usual code (pytorch-fid, torch-fidelity) takes `scipy.linalg.sqrtm` of the product of the two
covariances, torchmetrics the eigenvalues of that product. All get the same features of 2,048
dimensions, as Inception has them, and have to give the same distance: within 1e-6 of it where the
covariances are regular. With fewer images than dimensions they are singular, and roots of rounding
add up in the peers' distances: there within 1e-5. A distance takes the peers seconds, so those
compared are the ones that were timed.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import torch
from torch import Tensor
from torchmetrics.image.fid import _compute_fid

from racines_data.randomness import normal, sample_seeds
from racines_models.scores.metrics import frechet_distance
from tests.benchmarks.lines import line_of
from tests.benchmarks.turns import in_turns

SIZE = 2_048
USUAL, METRICS = "scipy's sqrtm, as torch-fidelity", "torchmetrics"


def features(count: int, seed: int) -> Tensor:
    """Return (N, D) float64 features whose variances fall over three decades, correlated."""
    plain = normal(sample_seeds(seed, count), SIZE).double()
    mixing = normal(sample_seeds(7, 64), SIZE).double()
    shared = normal(sample_seeds(seed + 1, count), 64).double()
    return plain * torch.logspace(0, -1.5, SIZE, dtype=torch.float64) + 0.1 * shared @ mixing + 0.5


def usual(reference: Tensor, candidate: Tensor) -> float:
    """Return the distance as the usual code has it, from features."""
    one, other = reference.numpy(), candidate.numpy()
    means = one.mean(0), other.mean(0)
    covariances = [np.cov(each, rowvar=False) for each in (one, other)]
    root = scipy.linalg.sqrtm(covariances[0] @ covariances[1])
    shift = np.square(means[0] - means[1]).sum()
    return float(
        shift + np.trace(covariances[0]) + np.trace(covariances[1]) - 2 * np.trace(root).real
    )


def metrics(reference: Tensor, candidate: Tensor) -> float:
    """Return the distance by torchmetrics' own function, from features."""
    told = [(each.mean(0), torch.cov(each.T)) for each in (reference, candidate)]
    return float(_compute_fid(*told[0], *told[1]))


@pytest.mark.timeout(600)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "allowed"), [(4_096, 1e-6), (1_024, 1e-5)], ids=["regular", "singular"]
)
def test_frechet_distance(benchmark, line, count: int, allowed: float) -> None:
    one, other = features(count, 10), features(count, 20) * 1.1
    sides: dict[str, Callable[[Tensor, Tensor], float]] = {
        "ours": frechet_distance, METRICS: metrics, USUAL: usual,
    }  # fmt: skip
    given: dict[str, Any] = {}

    def side(name: str) -> Callable[[], None]:
        return lambda: given.update({name: sides[name](one, other)})

    for work in sides.values():  # wakes threads and libraries
        work(one[:32, :16], other[:32, :16])
    times = in_turns({name: side(name) for name in sides}, rounds=2, warm=0)
    print(given)
    for name in (METRICS, USUAL):
        off = abs(given[name] - given["ours"]) / given["ours"]
        assert off <= allowed, (name, off)
    benchmark.pedantic(lambda: frechet_distance(one, other), rounds=1)
    work = f"Fréchet distance, {count:,} images, {SIZE:,} features"
    equal = f"distance, within {allowed:g} of it"
    line(line_of(work, "distances/s", 1, times, USUAL, equal, 3.0))
    line(line_of(work, "distances/s", 1, times, METRICS, equal))
