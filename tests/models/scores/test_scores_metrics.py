import numpy as np
import pytest
import torch
from scipy.ndimage import correlate1d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from racines_data.errors import RacinesError
from racines_models.scores.metrics import (
    PSNR_CAP,
    KernelMatrices,
    fid,
    kid,
    ms_ssim,
    psnr,
    ssim,
)
from racines_models.statistics import bootstrap_mean, jackknife


def images(n: int, seed: int = 0) -> torch.Tensor:
    """Smooth random gray images, with black corners as a sector has."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(n, 1, 16, 16, generator=generator)
    smooth = torch.nn.functional.interpolate(coarse, (128, 128), mode="bicubic")[:, 0]
    smooth[:, :30, :30] = 0
    return (smooth * 255).clamp(0, 255).to(torch.uint8)


def noisy(x: torch.Tensor, sigma: float, seed: int = 1) -> torch.Tensor:
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(seed)) * sigma
    return (x + noise).clamp(0, 255).to(torch.uint8)


def test_ssim_and_psnr_equal_scikit_image() -> None:
    truth = images(5)
    drawn = noisy(truth, 20)
    for i, (s, p) in enumerate(zip(ssim(drawn, truth), psnr(drawn, truth), strict=True)):
        a, b = drawn[i].numpy(), truth[i].numpy()
        expected = structural_similarity(
            a, b, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
        assert float(s) == pytest.approx(float(expected), abs=1e-4)
        expected = peak_signal_noise_ratio(b, a, data_range=255)
        assert float(p) == pytest.approx(float(expected), abs=1e-4)


@pytest.mark.parametrize("sigma", [2, 20, 80])
def test_ssim_and_psnr_equal_scikit_image_on_flat_and_on_noisy_images(sigma: int) -> None:
    truth = torch.cat([images(2, seed=sigma), torch.full((1, 128, 128), 40, dtype=torch.uint8)])
    drawn = noisy(truth, sigma, seed=sigma)
    settings = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    pairs = [(a.numpy(), b.numpy()) for a, b in zip(drawn, truth, strict=True)]
    expected = [structural_similarity(a, b, data_range=255, **settings) for a, b in pairs]
    assert ssim(drawn, truth).tolist() == pytest.approx(expected, abs=1e-4)
    expected = [peak_signal_noise_ratio(b, a, data_range=255) for a, b in pairs]
    assert psnr(drawn, truth).tolist() == pytest.approx(expected, abs=1e-4)


WANG = np.array([0.0448, 0.2856, 0.3001, 0.2363])
"""Weights of the scales in Wang et al., 2003, table 1, without the coarsest."""


def scales_by_hand(a: np.ndarray, b: np.ndarray) -> float:
    """MS-SSIM from its definition: float64, separable windows, whole ones only."""
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window /= window.sum()

    def local(x: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(x, window, 0), window, 1)[5:-5, 5:-5]

    weights, value = WANG / WANG.sum(), 1.0
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    a, b = a.astype(float), b.astype(float)
    for scale, weight in enumerate(weights):
        ma, mb = local(a), local(b)
        va, vb, covariance = local(a * a) - ma**2, local(b * b) - mb**2, local(a * b) - ma * mb
        term = (2 * covariance + c2) / (va + vb + c2)
        if scale == len(weights) - 1:
            term = term * (2 * ma * mb + c1) / (ma**2 + mb**2 + c1)
        value *= max(term.mean(), 0.0) ** weight
        a, b = (x.reshape(len(x) // 2, 2, -1, 2).mean((1, 3)) for x in (a, b))
    return float(value)


@pytest.mark.parametrize("sigma", [3, 30, 90])
def test_ms_ssim_equals_its_definition(sigma: int) -> None:
    truth = images(3, seed=sigma)
    drawn = noisy(truth, sigma)
    expected = [scales_by_hand(a.numpy(), b.numpy()) for a, b in zip(drawn, truth, strict=True)]
    assert ms_ssim(drawn, truth).tolist() == pytest.approx(expected, abs=1e-4)
    inverted = 255 - truth
    assert ms_ssim(inverted, truth).tolist() == pytest.approx([0.0] * 3)


def test_texture_that_is_inverted_at_one_scale_is_not_like():
    truth, texture = images(2).int(), torch.full((128, 128), 30)
    texture[::2, ::2] = texture[1::2, 1::2] = -30
    pair = [(truth + sign * texture).clamp(0, 255).to(torch.uint8) for sign in (1, -1)]
    assert [scales_by_hand(a.numpy(), b.numpy()) for a, b in zip(*pair, strict=True)] == [0.0] * 2
    assert ms_ssim(*pair).tolist() == [0.0] * 2
    coarse = [torch.nn.functional.avg_pool2d(x.float(), 2).to(torch.uint8) for x in pair]
    assert float(ssim(*coarse).min()) > 0.5


def test_identical_images_have_the_stated_limits() -> None:
    truth = images(3)
    assert torch.allclose(ms_ssim(truth, truth), torch.ones(3))
    assert torch.allclose(ssim(truth, truth), torch.ones(3))
    assert psnr(truth, truth).tolist() == [PSNR_CAP] * 3 == [100.0] * 3


def test_pairs_must_match() -> None:
    with pytest.raises(RacinesError, match="true ones"):
        ssim(images(3), images(2))


def test_kid_equals_the_definition_and_is_unbiased() -> None:
    generator = torch.Generator().manual_seed(0)
    x, y = (torch.randn(30, 16, generator=generator, dtype=torch.float64) for _ in range(2))
    total = 0.0
    n = len(x)
    for i in range(n):
        for j in range(n):
            xy = (float(x[i] @ y[j]) / 16 + 1) ** 3
            if i != j:
                total += ((float(x[i] @ x[j]) / 16 + 1) ** 3) / (n * (n - 1))
                total += ((float(y[i] @ y[j]) / 16 + 1) ** 3) / (n * (n - 1))
            total -= 2 * xy / n**2
    assert kid(y, x) == pytest.approx(total, rel=1e-9)
    draws = [
        kid(torch.randn(20, 8, generator=generator), torch.randn(20, 8, generator=generator))
        for _ in range(300)
    ]
    assert abs(np.mean(draws)) < 4 * np.std(draws) / 300**0.5


def test_kid_of_subsets_by_matrices_is_kid() -> None:
    generator = torch.Generator().manual_seed(0)
    x, y = (torch.randn(60, 16, generator=generator) + shift for shift in (0.0, 0.3))
    matrices = KernelMatrices(x, y)
    keep = np.arange(60) % 4 != 1
    rows = torch.from_numpy(keep)
    assert matrices.kid(np.ones(60, bool)) == pytest.approx(kid(y, x), rel=1e-9)
    assert matrices.kid(keep) == pytest.approx(kid(y[rows], x[rows]), rel=1e-9)


def test_kid_subsets_are_seeded_and_near_the_full_estimate() -> None:
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(400, 16, generator=generator)
    y = torch.randn(400, 16, generator=generator) + 0.5
    assert kid(x, y, 100, 50, seed=1) == kid(x, y, 100, 50, seed=1)
    assert kid(x, y, 100, 50, seed=1) == pytest.approx(kid(x, y), rel=0.1)


def test_kid_of_many_samples_is_the_mean_over_independent_subsets():
    x, y = (torch.randn(90, 8, generator=torch.Generator().manual_seed(s)) for s in (1, 2))
    generator, estimates = torch.Generator().manual_seed(3), []
    for _ in range(5):
        i, j = (torch.randperm(90, generator=generator)[:20] for _ in range(2))
        estimates.append(kid(y[j], x[i]))
    assert kid(y, x, 20, 5, seed=3) == pytest.approx(np.mean(estimates), rel=1e-9)
    assert kid(y, x, 90, 5) == kid(y, x)


def test_fid_orders_noise_levels() -> None:
    x = torch.randn(200, 32, generator=torch.Generator().manual_seed(0))
    assert fid(x + 0.1, x) < fid(x + 0.5, x)


def test_bootstrap_resamples_trajectories_not_frames() -> None:
    generator = np.random.default_rng(0)
    offsets = generator.normal(size=20)
    clusters = np.repeat(np.arange(20), 50)
    values = offsets[clusters] + 0.01 * generator.normal(size=1000)
    estimate = bootstrap_mean(values, clusters)
    assert estimate.low is not None and estimate.high is not None
    assert estimate.low < estimate.value < estimate.high
    # The spread of 20 trajectory means, not that of 1,000 frames.
    half = (estimate.high - estimate.low) / 2
    assert half == pytest.approx(1.96 * offsets.std() / 20**0.5, rel=0.15)
    assert (estimate.n, estimate.clusters) == (1000, 20)
    assert estimate == bootstrap_mean(values, clusters)


def test_bootstrap_leaves_out_absent_values_and_needs_two_trajectories() -> None:
    estimate = bootstrap_mean(np.array([1.0, np.nan, 3.0]), np.array([0, 0, 0]))
    assert (estimate.value, estimate.low, estimate.high, estimate.n) == (2.0, None, None, 2)
    with pytest.raises(ValueError, match="no values"):
        bootstrap_mean(np.array([np.nan]), np.array([0]))


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(0).normal(size=400)
    estimate = jackknife(lambda keep: float(values[keep].mean()), np.arange(400), blocks=400)
    assert estimate.low is not None and estimate.high is not None
    expected = 1.966 * values.std(ddof=1) / 20
    assert (estimate.high - estimate.low) / 2 == pytest.approx(expected, rel=1e-3)


def test_jackknife_covers_a_frechet_distance_without_inflating_it() -> None:
    covered = 0
    for seed in range(40):
        generator = torch.Generator().manual_seed(seed)
        x = torch.randn(400, 4, generator=generator)
        y = torch.randn(400, 4, generator=generator) + 0.5  # true distance 4 * 0.25 = 1

        def statistic(keep: np.ndarray, x: torch.Tensor = x, y: torch.Tensor = y) -> float:
            return fid(y[torch.from_numpy(keep)], x[torch.from_numpy(keep)])

        estimate = jackknife(statistic, np.repeat(np.arange(40), 10), minimum=0.0)
        assert estimate.low is not None and estimate.high is not None
        assert estimate.low <= estimate.value <= estimate.high
        covered += estimate.low <= 1.0 <= estimate.high
    assert covered >= 33


def test_a_row_of_ssim_ignores_its_batch() -> None:
    """Of 19 images 8 are taken at a time on a CPU, and three are left over."""
    generator = torch.Generator().manual_seed(0)
    truth, drawn = torch.randint(0, 256, (2, 19, 128, 128), generator=generator).to(torch.uint8)
    every = ssim(drawn, truth)
    for rows in (slice(0, 1), slice(5, 14), slice(16, 19)):
        assert torch.equal(ssim(drawn[rows], truth[rows]), every[rows])
