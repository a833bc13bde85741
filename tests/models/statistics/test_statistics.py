"""Intervals against their definitions, and against scipy's where it has them."""

import numpy as np
import pytest
from scipy import stats

from racines_models.statistics import (
    Estimate,
    bootstrap_mean,
    jackknife,
    jackknife_all,
    median,
    wilson,
)

SIZES = [3, 5, 1, 8, 2, 4, 6]
SWEEP = np.repeat(np.arange(7), SIZES)
VALUES = np.random.default_rng(0).exponential(size=len(SWEEP)) + SWEEP


def test_the_mean_is_that_of_resampled_trajectories_long_and_short():
    estimate = bootstrap_mean(VALUES, SWEEP, seed=2, resamples=200)
    values, sweep, means = VALUES, SWEEP, []
    repeated = np.random.default_rng(2)
    for draws in repeated.multinomial(7, np.full(7, 1 / 7), size=200):
        frames = [np.repeat(values[sweep == c], draws[c]) for c in range(7)]
        means.append(np.concatenate(frames).mean())
    assert [estimate.low, estimate.high] == pytest.approx(np.quantile(means, [0.025, 0.975]))
    assert estimate.value == VALUES.mean() and estimate.method.endswith(", 200 resamples")
    assert bootstrap_mean(VALUES, SWEEP, seed=3, resamples=200).low != estimate.low


def test_names_of_trajectories_and_their_order_do_not_matter():
    names = np.array([f"sweep-{9 - c}" for c in SWEEP])
    plain = bootstrap_mean(VALUES, 100 - SWEEP, resamples=50)
    assert bootstrap_mean(VALUES, names, resamples=50) == plain
    one = bootstrap_mean(VALUES[:3], SWEEP[:3])
    assert (one.value, one.low, one.high, one.clusters) == (VALUES[:3].mean(), None, None, 1)


def test_an_estimate_is_written_with_its_interval_and_settings():
    estimate = Estimate(2.0, 1.0, 3.0, 40, 4, "jackknife")
    expected = {"value": 2.0, "low": 1.0, "high": 3.0, "n": 40}
    settings = {"k": 5, "interval": "jackknife", "trajectories": 4}
    assert estimate.to_json(k=5) == expected | {"settings": settings}
    assert estimate.to_json("mm", k=5) == expected | {"unit": "mm", "settings": settings}


@pytest.mark.parametrize("blocks", [20, 7, 3])
def test_the_jackknife_leaves_out_whole_trajectories_and_takes_students_t(blocks):
    seen = []

    def statistic(keep: np.ndarray) -> float:
        seen.append(keep)
        return float(VALUES[keep].mean())

    estimate = jackknife(statistic, SWEEP, blocks)
    count = min(blocks, 7)
    assert seen[0].all() and len(seen) == 1 + count
    for block, keep in enumerate(seen[1:]):
        assert set(SWEEP[~keep]) == {c for c in range(7) if c % count == block}
        assert not set(SWEEP[keep]) & set(SWEEP[~keep])
    left = np.array([VALUES[keep].mean() for keep in seen[1:]])
    error = np.sqrt((count - 1) / count * ((left - left.mean()) ** 2).sum())
    half = stats.t.ppf(0.975, count - 1) * error
    assert [estimate.low, estimate.high] == pytest.approx(
        [VALUES.mean() - half, VALUES.mean() + half]
    )
    assert (estimate.n, estimate.clusters) == (29, 7)


def test_the_jackknife_of_several_is_cut_where_no_value_can_be():
    figures = jackknife_all(
        lambda keep: {
            "share": float((VALUES[keep] > 6).mean()),
            "mean": float(VALUES[keep].mean()),
        },
        SWEEP,
        minimum=0.0,
    )
    assert figures["share"].low == 0.0 < figures["share"].value < figures["share"].high
    assert figures["mean"] == jackknife(lambda keep: float(VALUES[keep].mean()), SWEEP)
    one = jackknife(lambda keep: float(keep.sum()), np.zeros(9))
    assert (one.value, one.low, one.high, one.clusters) == (9.0, None, None, 1)


@pytest.mark.parametrize("n", [1, 3, 10, 400])
def test_the_rate_has_scipys_wilson_interval(n):
    for hits in range(0, n + 1, max(n // 8, 1)):
        figure = wilson(np.arange(n) < hits)
        expected = stats.binomtest(hits, n).proportion_ci(0.95, "wilson")
        assert (figure["value"], figure["n"]) == (hits / n, n)
        assert [figure["low"], figure["high"]] == pytest.approx(list(expected), abs=1e-12)
        assert 0.0 <= figure["low"] <= figure["value"] <= figure["high"] <= 1.0


def test_a_rate_of_none_or_all_is_an_end_of_its_interval():
    """Not off by rounding, as the formula is for a third of all numbers of trials."""
    for n in range(1, 101):
        none, every = wilson(np.zeros(n, bool)), wilson(np.ones(n, bool))
        assert (none["low"], every["high"]) == (0.0, 1.0)
        assert none["high"] == pytest.approx(1.0 - every["low"]) and none["high"] > 0.0


def test_the_median_of_times_is_that_of_resampled_times():
    values = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 512.0])
    figure = median(values, "ms", resamples=500)
    drawn = values[np.random.default_rng(0).integers(0, 8, (500, 8))]
    expected = np.quantile(np.median(drawn, axis=-1), [0.025, 0.975])
    assert figure["value"] == 12.0 and figure["n"] == 8 and figure["unit"] == "ms"
    assert [figure["low"], figure["high"]] == pytest.approx(expected)
    assert "500 resamples" in figure["settings"]["interval"]
    one = median(np.array([3.0]))
    assert (one["value"], one["low"], one["high"], one["n"]) == (3.0, None, None, 1)
    assert "unit" not in one and median(np.array([]))["value"] is None
