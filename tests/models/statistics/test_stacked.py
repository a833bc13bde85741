"""Many methods compared at a time as two are."""

import numpy as np
import pytest

from racines_models.statistics.intervals import Replicates, difference, mean_replicates
from racines_models.statistics.stacked import Stacked

RANDOM = np.random.default_rng(3)


def method(units: int, trainings: int, level: float, spread: float) -> Replicates:
    values = RANDOM.gamma(1.0, 0.2, (1, units)) + level
    values = values + RANDOM.normal(0.0, 0.02, (trainings, units))
    return mean_replicates(values + spread * RANDOM.normal(size=(trainings, 1)), np.arange(units))


@pytest.mark.parametrize("units", [1, 2, 3, 6, 30, 140])
def test_each_low_end_is_that_of_the_two_alone(units):
    levels = RANDOM.normal(0.0, 0.05, 12)
    methods = [method(units, 1 + i % 3, level, 0.02 * (i % 2)) for i, level in enumerate(levels)]
    methods += [methods[0], Replicates(methods[1].whole + 1, methods[1].without + 1, units, units)]
    stack = Stacked.of(methods)
    for i, own in enumerate(methods):
        wanted = [difference(each, own).low for each in methods]
        found = stack.lows(slice(None), i)
        assert found.shape == (len(methods),)
        for low, told in zip(found, wanted, strict=True):
            assert np.isnan(low) if told is None else low == pytest.approx(told, abs=1e-12)
    assert stack.lows(slice(0, 0), 3).shape == (0,)


def test_methods_on_other_units_are_refused():
    with pytest.raises(ValueError, match="same units"):
        Stacked.of([method(6, 3, 0.0, 0.0), method(7, 3, 0.0, 0.0)])
