import numpy as np
import pytest
import scipy.linalg
import torch

from racines_data.errors import RacinesError
from racines_models.scores.metrics import _distance_by_covariance, frechet_distance


def textbook(x: torch.Tensor, y: torch.Tensor) -> float:
    """The published formula, with scipy's root of the non-symmetric product."""
    a, b = x.double().numpy(), y.double().numpy()
    root = scipy.linalg.sqrtm(np.cov(a, rowvar=False) @ np.cov(b, rowvar=False))
    trace = np.trace(np.cov(a, rowvar=False) + np.cov(b, rowvar=False) - 2 * np.real(root))
    return float(np.square(a.mean(0) - b.mean(0)).sum() + trace)


def features(n: int, d: int, seed: int, rank: int | None = None) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(n, rank or d, generator=generator, dtype=torch.float64)
    mixing = torch.randn(rank or d, d, generator=torch.Generator().manual_seed(5)).double()
    return x @ (mixing / d**0.5) + seed * 0.1


@pytest.mark.parametrize("d", [8, 64, 200])
def test_equals_the_textbook_on_well_conditioned_features(d: int) -> None:
    x, y = features(1000, d, 1), features(900, d, 2) * 1.3
    assert frechet_distance(x, y) == pytest.approx(textbook(x, y), rel=1e-6)
    assert _distance_by_covariance(x, y) == pytest.approx(textbook(x, y), rel=1e-6)


@pytest.mark.parametrize(("n", "rank"), [(500, 20), (60, 100), (101, 30)])
def test_equals_the_textbook_on_rank_deficient_features(n: int, rank: int) -> None:
    # A shared subspace: scipy's root of the singular product is itself exact to about 1e-7.
    x, y = features(n, 100, 1, rank), features(n, 100, 2, rank) * 0.7
    expected = textbook(x, y)
    assert frechet_distance(x, y) == pytest.approx(expected, rel=1e-6)
    assert _distance_by_covariance(x, y) == pytest.approx(expected, rel=1e-6)


def test_both_forms_agree_where_neither_has_full_rank() -> None:
    x, y = features(40, 128, 1), features(70, 128, 2)
    assert _distance_by_covariance(x, y) == pytest.approx(frechet_distance(x, y), rel=1e-6)


def test_is_zero_on_itself_and_symmetric() -> None:
    x, y = features(300, 32, 1), features(200, 32, 2)
    assert abs(frechet_distance(x, x)) < 1e-9
    assert frechet_distance(x, y) == pytest.approx(frechet_distance(y, x), rel=1e-9)


def test_grows_as_fewer_samples_are_drawn_from_one_law() -> None:
    few = frechet_distance(features(40, 64, 1), features(40, 64, 1)[:20])
    many = frechet_distance(features(4000, 64, 1), features(4000, 64, 1)[:2000])
    assert few > 5 * many


def test_refuses_single_images_and_nan() -> None:
    x = features(10, 4, 1)
    with pytest.raises(RacinesError, match="2 images"):
        frechet_distance(x, x[:1])
    broken = x.clone()
    broken[3, 2] = float("nan")
    with pytest.raises(RacinesError, match="not finite"):
        frechet_distance(x, broken)
