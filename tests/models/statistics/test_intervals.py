"""Intervals over few, skewed units and several trainings: exact cases, and simulated coverage."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import norm

from racines_models.statistics.intervals import (
    Replicates,
    blocks_of,
    combine,
    difference,
    interval,
    mean_replicates,
    median_interval,
    median_replicates,
    rate_interval,
    skewness_of,
    wilson_ends,
)
from racines_models.statistics.sets import set_replicates

UNITS = np.repeat(np.arange(8), [3, 9, 4, 7, 5, 6, 8, 2])
VALUES = np.random.default_rng(0).gamma(2.0, 1.0, (3, len(UNITS)))


def test_replicates_leave_out_whole_units_of_every_training():
    found = mean_replicates(VALUES, UNITS)
    assert np.allclose(found.whole, VALUES.mean(1))
    for unit in range(8):
        assert np.allclose(found.without[:, unit], VALUES[:, unit != UNITS].mean(1))
    assert (found.units, found.n) == (8, len(UNITS))
    as_sets = set_replicates([lambda keep, row=row: row[keep].mean() for row in VALUES], UNITS)
    assert np.allclose(as_sets.whole, found.whole) and np.allclose(as_sets.without, found.without)
    medians = median_replicates(VALUES, UNITS)
    assert np.allclose(medians.without[1, 2], np.median(VALUES[1, UNITS != 2]))


def test_absent_values_are_left_out_and_a_unit_of_them_is_no_unit():
    values = VALUES.copy()
    values[:, UNITS == 3] = np.nan
    found = mean_replicates(values, UNITS)
    assert found.units == 7 and found.n == int((UNITS != 3).sum())
    assert np.allclose(found.whole, np.nanmean(values, 1))
    with pytest.raises(ValueError, match="no values"):
        mean_replicates(np.full_like(VALUES, np.nan), UNITS)


def test_many_units_are_left_out_in_blocks_of_whole_units():
    units = np.repeat(np.arange(100), 3)
    blocks = blocks_of(units, most=12)
    assert len(np.unique(blocks)) == 12
    assert all(len(np.unique(blocks[units == unit])) == 1 for unit in range(100))


def test_of_symmetric_units_it_is_students_t():
    """No skewness to correct, one item a unit: the textbook's interval."""
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    found = interval(mean_replicates(values, np.arange(5)))
    expected = stats.t.interval(0.95, 4, 3.0, values.std(ddof=1) / 5**0.5)
    assert (found.low, found.high) == pytest.approx(expected)
    assert (found.value, found.units, found.trainings) == (3.0, 5, 1)


def test_skewed_units_reach_further_where_their_tail_is():
    values = np.array([1.0, 1.1, 1.2, 1.3, 9.0, 1.2, 1.4, 1.0])
    found = interval(mean_replicates(values, np.arange(8)))
    assert found.high - found.value > 2 * (found.value - found.low) > 0
    turned = interval(mean_replicates(-values, np.arange(8)))
    assert (-turned.high, -turned.low) == pytest.approx((found.low, found.high))


def test_its_ends_are_where_halls_transformation_is_students_t():
    values = np.random.default_rng(3).exponential(size=36)
    found = interval(mean_replicates(values, np.arange(36)))
    error, g = values.std(ddof=1) / 6.0, stats.skew(values, bias=False) / 6.0
    t = stats.t.ppf(0.975, 35)
    below, above = (found.value - found.low) / error, (found.high - found.value) / error
    assert above > below
    for end, expected in ((below, t), (-above, -t)):
        transformed = end + g * end**2 / 3 + g**2 * end**3 / 27 + g / 6
        assert transformed == pytest.approx(expected)


def test_few_units_reach_at_least_as_far_as_students_t():
    values = np.random.default_rng(3).exponential(size=9)
    found = interval(mean_replicates(values, np.arange(9)))
    half = stats.t.ppf(0.975, 8) * values.std(ddof=1) / 3.0
    assert found.value - found.low == pytest.approx(half)
    assert found.high - found.value > 1.1 * half


def test_trainings_widen_it_and_equal_ones_do_not():
    one = interval(mean_replicates(VALUES[0], UNITS))
    same = interval(mean_replicates(np.stack([VALUES[0]] * 3), UNITS))
    assert (same.low, same.high) == pytest.approx((one.low, one.high))
    apart = interval(mean_replicates(VALUES[0] + np.array([[-1.0], [0.0], [1.0]]), UNITS))
    assert apart.low < one.low and apart.high > one.high
    # Student's t of three values, 2 degrees of freedom, added in squares.
    half = 4.302652729911275 * 1.0 / 3**0.5
    assert apart.high - apart.value == pytest.approx(np.hypot(one.high - one.value, half))
    assert apart.value - apart.low == pytest.approx(np.hypot(one.value - one.low, half))
    assert "t over 3 trainings" in apart.method and apart.trainings == 3


def test_a_rate_of_all_or_none_is_wilsons_over_units():
    """Frames of one trajectory are no trials: 40 hits of 8 units say no more than 8 of 8."""
    for rate, hits in ((1.0, np.ones_like(UNITS)), (0.0, np.zeros_like(UNITS))):
        found = rate_interval(hits, UNITS)
        assert (found.low, found.high) == pytest.approx(wilson_ends(rate, 8))
    some = rate_interval(UNITS > 2, UNITS)
    assert 0.0 <= some.low < some.value < some.high <= 1.0
    # Ten times as many frames of the same units say no more.
    longer = rate_interval(np.repeat(UNITS > 2, 10), np.repeat(UNITS, 10))
    assert (longer.low, longer.high) == pytest.approx((some.low, some.high))


def test_wilson_is_that_of_statsmodels_and_scipy():
    theirs = stats.binomtest(45, 50).proportion_ci(0.95, "wilson")
    assert wilson_ends(0.9, 50) == pytest.approx((theirs.low, theirs.high))
    for n in range(1, 60):  # no rounding leaves the rate outside
        assert wilson_ends(0.0, n)[0] == 0.0 and wilson_ends(1.0, n)[1] == 1.0


def test_one_unit_or_training_alone_gives_what_it_can():
    alone = interval(mean_replicates(VALUES[0], np.zeros_like(UNITS)))
    assert alone.low is None and alone.high is None and alone.units == 1
    trained = interval(mean_replicates(VALUES, np.zeros_like(UNITS)))
    assert trained.low is not None and trained.low < trained.value


def test_a_difference_pairs_units_and_forgets_what_they_share():
    shared = 100.0 * UNITS
    first = mean_replicates(VALUES[0] + shared + 1.0, UNITS)
    second = mean_replicates(VALUES[0] + shared, UNITS)
    apart = difference(first, second)
    assert apart.value == pytest.approx(1.0)
    assert apart.low == pytest.approx(1.0) and apart.high == pytest.approx(1.0)
    assert interval(first).low < interval(second).value, "each alone says nothing"
    back = difference(second, first)
    assert (back.low, back.high) == pytest.approx((-apart.high, -apart.low))
    with pytest.raises(ValueError, match="same units"):
        difference(first, mean_replicates(VALUES[0], np.arange(len(UNITS)) % 5))


def test_a_difference_of_trained_methods_takes_welchs_t():
    base = VALUES[0]
    wide = mean_replicates(base + np.array([[-1.0], [0.0], [1.0]]), UNITS)
    fixed = mean_replicates(base, UNITS)
    one = difference(wide, fixed)
    assert one.high - one.value == pytest.approx(4.302652729911275 / 3**0.5)
    both = difference(wide, wide)  # two methods that spread alike: 4 degrees of freedom
    assert both.high == pytest.approx(2.7764451051977987 * (2 / 3) ** 0.5)


def test_a_score_of_several_metrics_has_replicates_too():
    a, b = mean_replicates(VALUES, UNITS), median_replicates(VALUES, UNITS)
    both = combine(lambda x: x.mean(0), [a, b])
    assert np.allclose(both.whole, (a.whole + b.whole) / 2)
    assert np.allclose(both.without, (a.without + b.without) / 2)
    short = Replicates(a.whole[:1], a.without[:1], a.units, a.n)
    with pytest.raises(ValueError, match="same trainings"):
        combine(lambda x: x.mean(0), [a, short])


def test_a_median_keeps_its_range_and_survives_blocks_that_empty_a_training():
    """One training succeeded once, the others twice: leaving that unit out leaves it no median."""
    steps = np.full((3, 8), np.nan)
    steps[0, 2], steps[1, [1, 2]], steps[2, [2, 5]] = 4.0, [9.0, 11.0], [40.0, 44.0]
    found = median_replicates(steps, np.arange(8))
    assert (
        found.value == pytest.approx((4.0 + 10.0 + 42.0) / 3) and np.isfinite(found.without).all()
    )
    assert (found.units, found.n) == (3, 1)
    assert median_interval(steps, np.arange(8)).low < 0.0
    held = median_interval(steps, np.arange(8), 0.0, 50.0)
    assert (held.low, held.high) == (0.0, 50.0)
    with pytest.raises(ValueError, match="no values"):
        median_replicates(np.full((1, 4), np.nan), np.arange(4))


def test_a_median_inverts_the_interval_of_the_share_below():
    rng = np.random.default_rng(1)
    values = rng.normal(0, 1, 4000)
    found = median_interval(values, np.arange(4000))
    # Independent values: order statistics of a binomial.
    low, high = np.sort(values)[stats.binom.ppf([0.025, 0.975], 4000, 0.5).astype(int)]
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.02)
    assert found.value == pytest.approx(np.median(values))
    # The same shares are inverted where the mean lies far from the median.
    far = np.exp(2.0 * values)
    skewed = median_interval(far, np.arange(4000))
    assert skewed.value == pytest.approx(np.median(far))
    assert (far < skewed.low).mean() == pytest.approx((values < found.low).mean(), abs=1e-3)
    assert (far < skewed.high).mean() == pytest.approx((values < found.high).mean(), abs=1e-3)


def coverage(kind: str, units: int, draws: int = 300) -> float:
    """How often the interval of skewed, unequal units and three trainings holds the truth."""
    rng = np.random.default_rng(7)
    sizes, level = rng.integers(5, 40, 300), rng.gamma(1.5, 1.0, 300)
    truth, held = np.average(level, weights=sizes), 0
    for _ in range(draws):
        chosen = rng.integers(0, 300, units)
        of = np.repeat(np.arange(units), sizes[chosen])
        one, two = (
            rng.normal(0, 0.2, (3, 1)) + (level[chosen] + rng.normal(0, 0.3, (3, units)))[:, of]
            for _ in range(2)
        )
        if kind == "mean":
            found, expected = interval(mean_replicates(one, of)), truth
        else:
            found, expected = difference(mean_replicates(one, of), mean_replicates(two, of)), 0.0
        held += found.low <= expected <= found.high
    return held / draws


@pytest.mark.parametrize("units", [6, 30])
@pytest.mark.parametrize("kind", ["mean", "difference"])
def test_it_covers_about_as_often_as_it_says(kind, units):
    """Within four standard errors of a simulation of 300: 1.3 % each."""
    assert 0.90 <= coverage(kind, units) <= 0.995


def test_what_is_written_again_for_speed_is_the_librarys_to_the_last_bit():
    """Skewness is scipy's, and the medians without a block NumPy's."""
    random = np.random.default_rng(5)
    for count in (3, 4, 9, 40):
        for values in random.gamma(0.5, 3.0, (50, count)):
            assert skewness_of(values) == stats.skew(values, bias=False)
    for count in (8, 31, 200):
        values = random.gamma(2.0, 1.0, (2, count)).round(2)
        values[:, random.random(count) < 0.2] = np.nan
        units = np.arange(count) % 7
        found = median_replicates(values, units)
        assert found.whole.tolist() == np.nanmedian(values, 1).tolist()
        kept = [np.nanmedian(values[:, units != unit], 1) for unit in range(7)]
        assert found.without.tolist() == np.array(kept).T.tolist()


def test_a_median_beside_a_pile_is_no_point():
    """Episodes of 140 patients, five each: 48 % end at the longest, the median is just below."""
    chance = np.random.default_rng(0)
    units, held, points = np.repeat(np.arange(140), 5), 0, 0
    for _ in range(100):
        latent = 0.5 * chance.normal(size=140)[:, None] + chance.normal(size=(140, 5))
        rank = norm.cdf(latent / np.sqrt(1.25)).ravel()
        found = median_interval(np.where(rank > 0.52, 20.0, 3 + 17 * rank / 0.52), units)
        assert found.low is not None and found.high is not None
        held += found.low - 1e-9 <= 3 + 17 * 0.5 / 0.52 <= found.high + 1e-9
        points += found.low == found.high
    assert held >= 90 and points <= 5


def test_methods_that_lack_values_of_other_units_are_not_compared():
    first, units = np.arange(10.0), np.arange(10)
    one, two = first.copy(), first + 1
    one[0], two[9] = np.nan, np.nan
    with pytest.raises(ValueError, match="others lack values"):
        difference(mean_replicates(one, units), mean_replicates(two, units))
    two[9], two[0] = 10.0, np.nan
    assert difference(mean_replicates(one, units), mean_replicates(two, units)).value == -1.0
