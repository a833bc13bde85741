"""Methods on the same units compared with each other, thousands at a time: the places of a board.

The intervals are those of `intervals.difference`, whose docstring has their sources. Those are
published digit by digit; of these the sign of an end alone is used, so last bits do not count.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from racines_models.statistics.intervals import (
    FEW,
    LEVEL,
    Replicates,
    students_t,
    variance_of_trainings,
)


@dataclass(frozen=True)
class Stacked:
    """P methods on the same units, to be compared with each other many at a time."""

    value: np.ndarray
    """(P,)"""
    without: np.ndarray
    """(P, B), means over trainings."""
    variance: np.ndarray
    """(P,) of the trainings."""
    freedom: np.ndarray
    """(P,) its degrees of freedom."""

    @classmethod
    def of(cls, replicates: Sequence[Replicates]) -> "Stacked":
        """Stack replicates.

        Raises:
            ValueError: their units or blocks are not the same.
        """
        if len({(each.units, each.without.shape[1]) for each in replicates}) > 1:
            raise ValueError("methods are compared on the same units alone")
        trained = np.array([variance_of_trainings(each) for each in replicates]).reshape(-1, 2)
        without = [each.without.mean(0) for each in replicates]
        return cls(np.array([each.value for each in replicates]), np.array(without), *trained.T)

    def lows(self, which: slice, other: int) -> np.ndarray:
        """Return (p,) low ends of the intervals of some methods less another.

        Those of `difference`, but for the last bit; NaN where there is no interval.
        """
        value = self.value[which] - self.value[other]
        blocks = self.without.shape[1]
        if blocks < 2:
            return np.full(len(value), np.nan)
        without = self.without[which] - self.without[other]
        pseudo = blocks * value[:, None] - (blocks - 1) * without
        about = pseudo - pseudo.mean(1, keepdims=True)
        squares = np.square(about)
        error = np.sqrt(squares.sum(1) / (blocks - 1) / blocks)
        flat = error <= 1e-12 * np.maximum(1.0, np.abs(value))
        t, shape = students_t(blocks - 1), np.zeros(len(value))
        if blocks > 2:
            second = np.where(flat, 1.0, squares.mean(1))
            shape = (squares * about).mean(1) / second**1.5
            shape *= ((blocks - 1.0) * blocks) ** 0.5 / (blocks - 2.0) / np.sqrt(blocks)
        few = blocks < FEW
        shape = shape * (1.0 + 4.0 / blocks) if few else shape
        bent = np.where(np.abs(shape) < 1e-9, 1.0, shape)
        reach = 3.0 / bent * (np.cbrt(1.0 + bent * (t - bent / 6.0)) - 1.0)
        reach = np.where(np.abs(shape) < 1e-9, t, reach)
        below = np.where(flat, 0.0, error * (np.maximum(reach, t) if few else reach))
        return value - np.hypot(below, self._spread(which, other))

    def _spread(self, which: slice, other: int) -> np.ndarray:
        """Return (p,) half-widths over the trainings of both, with Welch's degrees of freedom."""
        variance = self.variance[which] + self.variance[other]
        shares = np.square(self.variance) / np.maximum(self.freedom, 1.0)
        shares = shares[which] + shares[other]
        freedom = np.where(shares > 0, np.square(variance) / np.where(shares > 0, shares, 1.0), 1.0)
        return stats.t.ppf(0.5 + LEVEL / 2, freedom) * np.sqrt(variance)
