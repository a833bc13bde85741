"""Intervals of scores whose units are few, skewed, unequal, and shared by several trainings.

A *unit* is what was drawn independently: a trajectory, a patient, a start. Frames of one unit are
near-copies. A trained method has several *trainings*, each scored on the same units (crossed). What
is kept of a metric are its `Replicates`: the value of each training, whole and with each unit (or
block of units) left out. From those alone come its interval, the interval of the difference of two
methods on the same units, and, since any function of several metrics has replicates too, that of
a score made of them.

    units       pseudo-values of the delete-one-unit jackknife (Tukey, 1958), their mean with a t
                interval that is corrected for their skewness by Hall's transformation (Hall, On the
                removal of skewness by transformation, 1992)
                fewer than 30 units look less skewed than what they come from: their skewness is
                raised, and the interval reaches at least as far as Student's t
    a rate      Wilson's interval with as many trials as give the variance between units, and t for
                z (Franco et al., Comparative study of confidence intervals for proportions in
                complex sample surveys, 2019); of 0 or 1 in every unit, units are the trials
    a median    inverts the interval of the share below it (Woodruff, 1952), which the jackknife of
                the median itself does not survive
    trainings   Student's t on the spread of their values; of a rate, Wilson's reach where longer
    together    MOVER (Zou and Donner, Construction of confidence limits about effect measures,
                2008): the distances from the value to the two ends add in squares

The spread that a training has because units are few is part of both; it is taken off the second.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from racines_models.statistics.levels import nominal

LEVEL = 0.95
"""Nominal coverage of every interval."""
PILED = 0.25
"""From this share of values equal to the median on, what lies below it is asked as well."""
BLOCKS = 40
"""Most blocks of units that are left out in turn."""
FEW = 30
"""Below so many units an interval reaches at least as far as Student's t on either side."""


@dataclass(frozen=True)
class Replicates:
    """A statistic of R trainings on U units, whole and with each of B blocks of units left out."""

    whole: np.ndarray
    """(R,)"""
    without: np.ndarray
    """(R, B); B is 0 where there is one unit."""
    units: int
    n: int
    """Items, such as frames, of one training."""
    used: np.ndarray | None = None
    """(B,) numbers of the blocks that are left out; None: not kept."""

    @property
    def value(self) -> float:
        """The mean over trainings."""
        return float(self.whole.mean())

    def pseudo(self) -> np.ndarray:
        """Return (B,) pseudo-values of the mean over trainings; their mean is nearly the value."""
        blocks = self.without.shape[1]
        return blocks * self.whole.mean() - (blocks - 1) * self.without.mean(0)


@dataclass(frozen=True)
class Interval:
    """A value with its interval; the ends are None where nothing could spread."""

    value: float
    low: float | None
    high: float | None
    n: int
    units: int
    trainings: int
    method: str
    kind: str = "mean"
    """Of what: a kind of the coverage study, by which the level is known."""

    def to_json(self, unit: str | None = None, **settings: Any) -> dict[str, Any]:
        """Return the interval as it stands in a scores file."""
        described = {key: getattr(self, key) for key in ("value", "low", "high", "n")}
        if unit is not None:
            described["unit"] = unit
        counts = {"units": self.units, "trainings": self.trainings}
        level = {} if self.low is None or self.level is None else {"level": self.level}
        return described | {"settings": settings | {"interval": self.method} | level | counts}

    @property
    def level(self) -> float | None:
        """The nominal level, or the coverage measured of intervals like this where it is less.

        None where none was measured.
        """
        return nominal(self.kind, self.units, self.trainings)


def blocks_of(units: np.ndarray, most: int = BLOCKS) -> np.ndarray:
    """Return (N,) block numbers of (N,) unit labels; each unit is whole in one block."""
    _, number = np.unique(units, return_inverse=True)
    return number % most


def mean_replicates(values: np.ndarray, units: np.ndarray, most: int = BLOCKS) -> Replicates:
    """Return the replicates of the mean of (R, N) or (N,) values; NaN is an absent measurement.

    Raises:
        ValueError: no value is present in a training.
    """
    values = np.atleast_2d(np.asarray(values, np.float64))
    blocks = blocks_of(units, most)
    present = np.isfinite(values)
    if not present.any(1).all():
        raise ValueError("no values to estimate from")
    one_hot = np.eye(blocks.max() + 1)[blocks]
    sums = np.where(present, values, 0.0) @ one_hot
    counts = present.astype(np.float64) @ one_hot
    total, count = sums.sum(1, keepdims=True), counts.sum(1, keepdims=True)
    used = _used(counts)
    without = (total - sums[:, used]) / (count - counts[:, used])
    shown = np.unique(np.asarray(units)[present.any(0)])
    whole, n = total[:, 0] / count[:, 0], int(present[0].sum())
    return replace(checked(whole, without, len(shown), n), used=used)


def median_replicates(values: np.ndarray, units: np.ndarray, most: int = BLOCKS) -> Replicates:
    """Return the replicates of the median, as `mean_replicates` does of the mean."""
    values = np.atleast_2d(np.asarray(values, np.float64))
    # What is to be left out, and what of a sparse metric cannot be, is the same for its mean.
    means, blocks = mean_replicates(values, units, most), blocks_of(units, most)
    present = np.isfinite(values)
    used = _used(present @ np.eye(blocks.max() + 1)[blocks])
    pairs = zip(values, present, strict=True)
    found = [_medians(row[shown], blocks[shown], used) for row, shown in pairs]
    whole, without = zip(*found, strict=True)
    return replace(checked(np.array(whole), np.stack(without), means.units, means.n), used=used)


def _medians(values: np.ndarray, blocks: np.ndarray, used: np.ndarray) -> tuple[Any, np.ndarray]:
    """Return the median of (N,) values, and with each of the blocks in use left out.

    As NumPy's, to the last bit; the values are sorted once, for all blocks.
    """
    order = np.argsort(values, kind="stable")
    values, blocks = values[order], blocks[order]
    kept = [values, *(values[blocks != block] for block in used)]
    middles = np.array([(each[(len(each) - 1) // 2], each[len(each) // 2]) for each in kept])
    medians = np.where(middles[:, 0] == middles[:, 1], middles[:, 0], middles.sum(1) / 2)
    return medians[0], medians[1:]


def _used(counts: np.ndarray) -> np.ndarray:
    """Return which of B blocks hold values and leave some; of (R, B) counts of values."""
    left = counts.sum(1, keepdims=True) - counts
    return np.flatnonzero((counts.sum(0) > 0) & (left > 0).all(0))


def checked(whole: np.ndarray, without: np.ndarray, units: int, n: int) -> Replicates:
    """Return replicates, with none left out where there is but one unit."""
    if without.shape[1] < 2:
        without = without[:, :0]
    return Replicates(whole, without, units, n)


def interval(
    replicates: Replicates,
    minimum: float = -np.inf,
    maximum: float = np.inf,
    kind: str = "mean",
) -> Interval:
    """Return the interval of a statistic, cut at the least and the most that it can be."""
    ends, spread = _of_units(replicates), _of_trainings(replicates)
    return _joined(replicates, kind, ends, (spread, spread), "pseudo-values", minimum, maximum)


def mean_interval(
    values: np.ndarray, units: np.ndarray, minimum: float = -np.inf, maximum: float = np.inf
) -> Interval:
    """Return the interval of the mean of (R, N) or (N,) values, NaN where there is none."""
    return interval(mean_replicates(values, units), minimum, maximum)


def rate_interval(hits: np.ndarray, units: np.ndarray) -> Interval:
    """Return the interval of a rate of (R, N) or (N,) booleans, NaN where not asked."""
    replicates = mean_replicates(np.asarray(hits, np.float64), units)
    value, pseudo = replicates.value, replicates.pseudo()
    if value in (0.0, 1.0):
        reach = _wilson_reach(value, replicates.units)
        told = f"Wilson, {replicates.units} units as trials"
        return _joined(replicates, "rate", reach, (0.0, 0.0), told, 0.0, 1.0)
    of_units = None
    if len(pseudo) > 1:
        error = float(pseudo.var(ddof=1)) / len(pseudo)
        t = students_t(len(pseudo) - 1)
        of_units = _wilson_reach(value, value * (1.0 - value) / error, t) if error else (0.0, 0.0)
    variance, freedom = variance_of_trainings(replicates)
    of_trainings = (0.0, 0.0)
    if variance:
        t = students_t(freedom)
        below, above = _wilson_reach(value, value * (1.0 - value) / variance, t)
        # Trainings are no trials: near 1 they may spread as far to that side as to the other.
        of_trainings = max(below, t * np.sqrt(variance)), max(above, t * np.sqrt(variance))
    told = "Wilson, trials as many as units tell"
    return _joined(replicates, "rate", of_units, of_trainings, told, 0.0, 1.0)


def _wilson_reach(rate: float, n: float, z: float | None = None) -> tuple[float, float]:
    """Return how far Wilson's interval reaches below and above a rate."""
    low, high = wilson_ends(rate, n, z)
    return rate - low, high - rate


def median_interval(
    values: np.ndarray, units: np.ndarray, minimum: float = -np.inf, maximum: float = np.inf
) -> Interval:
    """Return the interval of the median of (R, N) or (N,) values, each training's taken apart.

    Where many values are one, such as episodes that ran out of time, and the median is that one,
    nearly all lie at or below it in every unit, which tells nothing of how it scatters: there the
    share that lies below is asked as well, and the interval reaches as far as the wider of both.
    """
    values = np.atleast_2d(np.asarray(values, np.float64))
    replicates = median_replicates(values, units)
    value, ends = replicates.value, None
    middles = np.nanmedian(values, axis=1, keepdims=True)
    reaches = [_woodruff(*each, units) for each in zip(values, middles[:, 0], strict=True)]
    reaches = [each for each in reaches if each is not None]
    if len(reaches) == len(values):
        # Of each training about its own median: they are of the same units, so their errors agree.
        shares = np.clip([(0.5 - up, 0.5 + down) for down, up in reaches], 0.0, 1.0)
        at = [np.nanquantile(*each) for each in zip(values, shares, strict=True)]
        low, high = np.mean(at, axis=0)
        ends = max(value - low, 0.0), max(high - value, 0.0)
    spread = _of_trainings(replicates)
    return _joined(replicates, "median", ends, (spread, spread), "Woodruff", minimum, maximum)


def _woodruff(values: np.ndarray, middle: float, units: np.ndarray) -> np.ndarray | None:
    """Return how far the share of (N,) values at or below their median reaches down and up."""
    known = np.isfinite(values)
    below = [values <= middle]
    if (values[known] == middle).mean() >= PILED:
        below.append(values < middle)
    shares = (mean_replicates(np.where(known, each, np.nan), units) for each in below)
    found = [each for each in map(_of_units, shares) if each is not None]
    return np.max(found, axis=0) if len(found) == len(below) else None


def difference(first: Replicates, second: Replicates, kind: str = "difference") -> Interval:
    """Return the interval of first - second on the same units; trainings are independent.

    Raises:
        ValueError: their units or blocks are not the same.
    """
    if (first.units, first.without.shape[1]) != (second.units, second.without.shape[1]):
        raise ValueError("two methods are compared on the same units alone")
    one, two = first.used, second.used
    if one is not None and two is not None and not np.array_equal(one, two):
        raise ValueError("two methods are compared on the same units alone: others lack values")
    apart = Replicates(
        np.array([first.value - second.value]),
        (first.without.mean(0) - second.without.mean(0))[None],
        first.units,
        min(first.n, second.n),
    )
    trained = [pair for pair in map(variance_of_trainings, (first, second)) if pair[1]]
    variance = sum(each for each, _ in trained)
    # Welch's degrees of freedom: the two methods' trainings need not spread alike.
    squares = sum(each**2 / freedom for each, freedom in trained)
    freedom = variance**2 / squares if squares else 1.0
    spread = students_t(freedom) * np.sqrt(variance)
    spread = float(spread), float(spread)
    return _joined(apart, kind, _of_units(apart), spread, "paired pseudo-values")


def combine(
    function: Callable[[np.ndarray], np.ndarray], replicates: Sequence[Replicates]
) -> Replicates:
    """Return the replicates of a function of several statistics of the same trainings and units.

    The function takes (M, …) values of the M statistics and returns (…).

    Raises:
        ValueError: their trainings, units or blocks are not the same.
    """
    first = replicates[0]
    if any(each.without.shape != first.without.shape for each in replicates):
        raise ValueError("statistics are combined over the same trainings and units alone")
    whole = function(np.stack([each.whole for each in replicates]))
    without = function(np.stack([each.without for each in replicates]))
    n, units = (min(getattr(each, key) for each in replicates) for key in ("n", "units"))
    return Replicates(whole, without, units, n)


def wilson_ends(rate: float, n: float, z: float | None = None) -> tuple[float, float]:
    """Return the ends of Wilson's score interval of a rate of n trials (Wilson, 1927)."""
    z = float(stats.norm.ppf(0.5 + LEVEL / 2)) if z is None else z
    centre = (rate + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    # The interval reaches its end exactly where no or every trial was a hit.
    low = 0.0 if rate == 0.0 else float(centre - half)
    return low, (1.0 if rate == 1.0 else float(centre + half))


def _of_units(replicates: Replicates) -> tuple[float, float] | None:
    """Return how far the interval over units reaches below and above the value."""
    pseudo = replicates.pseudo()
    count = len(pseudo)
    if count < 2:
        return None
    error = float(pseudo.std(ddof=1)) / np.sqrt(count)
    if error <= 1e-12 * max(1.0, abs(replicates.value)):
        return 0.0, 0.0
    t = students_t(count - 1)
    skewness = skewness_of(pseudo) / np.sqrt(count) if count > 2 else 0.0
    if count >= FEW:
        return error * _hall(t, skewness), -error * _hall(-t, skewness)
    # Few units rarely hold the far end of a tail: they look less skewed than what they come from.
    skewness *= 1.0 + 4.0 / count
    reaches = error * _hall(t, skewness), -error * _hall(-t, skewness)
    return max(reaches[0], error * t), max(reaches[1], error * t)


@functools.lru_cache(4096)
def students_t(freedom: float) -> float:
    """Return how many standard errors Student's t interval reaches to either side."""
    return float(stats.t.ppf(0.5 + LEVEL / 2, freedom))


def skewness_of(values: np.ndarray) -> float:
    """Return the adjusted skewness of (N,) values, three or more that are not all equal.

    scipy's, to the last bit, without its checks of every call: a board asks for tens of thousands.
    """
    count, about = len(values), values - values.mean()
    second, third = np.square(about).mean(), (np.square(about) * about).mean()
    return float(((count - 1.0) * count) ** 0.5 / (count - 2.0) * third / second**1.5)


def _hall(x: float, g: float) -> float:
    """Return the inverse of Hall's monotone transformation t + g t² / 3 + g² t³ / 27 + g / 6."""
    return x if abs(g) < 1e-9 else 3.0 / g * (float(np.cbrt(1.0 + g * (x - g / 6.0))) - 1.0)


def _of_trainings(replicates: Replicates) -> float:
    """Return the half-width over trainings."""
    variance, freedom = variance_of_trainings(replicates)
    return students_t(freedom) * np.sqrt(variance) if freedom else 0.0


def variance_of_trainings(replicates: Replicates) -> tuple[float, int]:
    """Return the variance of the mean over trainings, less what few units add; its freedom."""
    count = len(replicates.whole)
    if count < 2:
        return 0.0, 0
    variance = float(replicates.whole.var(ddof=1)) / count
    blocks = replicates.without.shape[1]
    if blocks > 1:
        # The interaction of training and unit: each training's own about what all share.
        own = replicates.without - replicates.without.mean(1, keepdims=True)
        both = np.square(own - own.mean(0)).sum() / (count - 1) / count
        variance = max(variance - (blocks - 1) / blocks * float(both), 0.0)
    return variance, count - 1


def _joined(
    replicates: Replicates,
    kind: str,
    ends: tuple[float, float] | None,
    spread: tuple[float, float],
    how: str,
    minimum: float = -np.inf,
    maximum: float = np.inf,
) -> Interval:
    value, trainings = replicates.value, len(replicates.whole)
    if ends is None and trainings < 2:
        low = high = None
    else:
        below, above = ends or (0.0, 0.0)
        low = max(value - float(np.hypot(below, spread[0])), minimum)
        high = min(value + float(np.hypot(above, spread[1])), maximum)
    method = f"{how} over {replicates.units} units" + (
        f", t over {trainings} trainings" if trainings > 1 else ""
    )
    return Interval(value, low, high, replicates.n, replicates.units, trainings, method, kind)
