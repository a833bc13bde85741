"""Studies drawn from a population, and how often their intervals contain the population's value.

A study draws whole trajectories with replacement, unequal lengths and all, and as many trainings of
each method. The one training of a study of one is the first that was measured, and what its
interval is to contain is that training's value over the population. Several are drawn anew in each
study: the mean of the measured trainings plus their deviations from it in random proportions
(Gaussian, so that the drawn ones spread as the measured ones do, frame by frame); what the interval
is to contain is the mean over all trainings that could be drawn. A method of one measured training
takes the other's deviations.

The expectation of FID depends on the number of frames: what its interval is to contain is the mean
of the studies of that size themselves. The same holds of scores made of it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from racines_models.scores import metrics
from racines_models.statistics.intervals import (
    Interval,
    Replicates,
    combine,
    difference,
    interval,
    mean_replicates,
    median_interval,
    median_replicates,
    rate_interval,
)
from racines_models.statistics.sets import set_replicates
from racines_models.studies.coverage.population import FIGURES, Method, Population

ITEMS = ("mean", "skewed mean", "rate", "episodes", "median", "difference", "frames as units")
"""Kinds of items: mean SSIM; mean pose error; frames with a sufficient SSIM; sweeps with one, one
item a unit; median pose error; difference of two methods' mean SSIM; mean SSIM with an interval
that takes frames for independent, which no score has: it shows what the study can tell."""
SETS = ("fid", "kid", "score", "score difference")
"""Kinds of whole sets: the two distances, the anchored score, and that of two methods apart."""
RANKED = ("ssim", "psnr", "fid", "kid", "pose_error_mm")
DRAWS = 4000
"""Trainings drawn to find the mean over all of a rate or a median."""

Anchors = Mapping[str, tuple[float, float]]
"""The values of each ranked metric that score 0 and 1."""


@dataclass(frozen=True)
class CoverageConfig:
    """Which studies are drawn."""

    units: tuple[int, ...] = (6, 12, 30, 140)
    """Trajectories of a study."""
    trainings: tuple[int, ...] = (1, 3)
    """Trainings of each method in a study."""
    studies: int = 2000
    """Studies of each size, for figures of items."""
    set_studies: int = 500
    """The same, for FID, KID and the scores made of them."""
    frames: int = 1200
    """Frames of all trajectories together, spread evenly."""
    embedded: int = 240
    """How many of them have features."""
    dimensions: int = 32
    """Of the random subspace in which FID and KID are taken; 0 takes the features as they are."""
    missed: float = 0.05
    """Share of frames, and of sweeps, whose SSIM counts as a miss in a rate."""
    seed: int = 0


@dataclass(frozen=True)
class Trainings:
    """The trainings of a method that could be drawn: (K, N) values, or (K, N, D) features."""

    centre: np.ndarray
    deviations: np.ndarray
    own: bool
    """Whether the deviations are the method's, not another's."""

    @classmethod
    def of(cls, values: np.ndarray, others: np.ndarray) -> "Trainings":
        """Return those of a method; one training takes the others' deviations from their mean."""
        own = len(values) > 1
        spread = values if own else others
        return cls(values.mean(0), spread - spread.mean(0), own)

    def draw(self, proportions: np.ndarray | None, items: np.ndarray) -> np.ndarray:
        """Return the values of some items: (R, n), or (R, n, D), of (R, K) proportions.

        None is the first measured training.
        """
        deviations = self.deviations[:, items]
        if proportions is None:
            return (self.centre[items] + (deviations[0] if self.own else 0.0))[None]
        share = np.asarray(proportions / max(len(deviations) - 1, 1) ** 0.5)
        return self.centre[items] + np.tensordot(share, deviations, 1)


class Simulation:
    """Draws studies from a population and takes their intervals."""

    def __init__(self, population: Population, config: CoverageConfig, anchors: Anchors) -> None:
        """Find the limits of the rates and what the intervals are to contain."""
        self.config, self.population, self.anchors = config, population, anchors
        first, second = population.first, population.second
        self._first, self._second = _trainings(first, second), _trainings(second, first)
        where = [np.flatnonzero(population.unit == unit) for unit in range(population.units)]
        self._frames = where
        self._embedded = [np.flatnonzero(np.isin(population.embedded, each)) for each in where]
        ssim = first.figures["ssim"][:1]
        self._limit = float(np.quantile(ssim, config.missed))
        self._sweep_limit = float(np.quantile(_sweeps(ssim, population.unit), config.missed))

    def targets(self, trainings: int) -> dict[str, float]:
        """Return the population's value of each kind of items."""
        whole = np.arange(len(self.population.unit))
        ssim, pose = self._first["ssim"], self._first["pose_error_mm"]
        proportions = None
        if trainings > 1:
            generator = np.random.default_rng(self.config.seed)
            proportions = generator.standard_normal((DRAWS, len(ssim.deviations)))
            # The mean of the drawn is the centre's, as it is of all that could be drawn.
            proportions -= proportions.mean(0)
        of_ssim, of_pose = ssim.draw(proportions, whole), pose.draw(proportions, whole)
        apart = of_ssim.mean() - self._second["ssim"].draw(proportions, whole).mean()
        sweeps = _sweeps(of_ssim, self.population.unit)
        return {
            "mean": float(of_ssim.mean()),
            "skewed mean": float(of_pose.mean()),
            "rate": float((of_ssim > self._limit).mean()),
            "episodes": float((sweeps > self._sweep_limit).mean()),
            "median": float(np.median(of_pose, 1).mean()),
            "difference": float(apart),
            "frames as units": float(of_ssim.mean()),
        }

    def items(self, units: int, trainings: int, study: int) -> Iterator[tuple[str, Interval]]:
        """Yield the interval of each kind of items of one study."""
        picks, one, two = self._draw(units, trainings, study)
        frames, unit = _gather(self._frames, picks)
        ssim = self._first["ssim"].draw(one, frames)
        pose = self._first["pose_error_mm"].draw(one, frames)
        found = mean_replicates(ssim, unit)
        other = mean_replicates(self._second["ssim"].draw(two, frames), unit)
        sweeps = _sweeps(ssim, unit)
        yield "mean", interval(found)
        yield "skewed mean", interval(mean_replicates(pose, unit), 0.0)
        yield "rate", rate_interval(ssim > self._limit, unit)
        yield "episodes", rate_interval(sweeps > self._sweep_limit, np.arange(units))
        yield "median", median_interval(pose, unit)
        yield "difference", difference(found, other)
        yield "frames as units", interval(mean_replicates(ssim, np.arange(len(unit))))

    def sets(self, units: int, trainings: int, study: int) -> Iterator[tuple[str, Interval]]:
        """Yield the interval of each kind of whole sets of one study."""
        picks, one, two = self._draw(units, trainings, study)
        frames = _gather(self._frames, picks)
        embedded = _gather(self._embedded, picks)
        first = self._replicates(self._first, one, frames, embedded)
        second = self._replicates(self._second, two, frames, embedded)
        yield "fid", interval(first["fid"], 0.0, kind="set")
        yield "kid", interval(first["kid"], kind="set")
        one_score, two_score = (self._score(each) for each in (first, second))
        yield "score", interval(one_score, kind="score")
        yield "score difference", difference(one_score, two_score, kind="score difference")

    def _draw(
        self, units: int, trainings: int, study: int
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Return (U,) trajectories and the two methods' trainings."""
        generator = np.random.default_rng([self.config.seed, units, trainings, study])
        picks = generator.integers(self.population.units, size=units)
        if trainings == 1:
            return picks, None, None
        size = (2, trainings, len(self._first["ssim"].deviations))
        one, two = generator.standard_normal(size)
        return picks, one, two[:, : len(self._second["ssim"].deviations)]

    def _replicates(
        self,
        method: dict[str, Trainings],
        proportions: np.ndarray | None,
        frames: tuple[np.ndarray, np.ndarray],
        embedded: tuple[np.ndarray, np.ndarray],
    ) -> dict[str, Replicates]:
        """Return the replicates of the ranked metrics."""
        drawn = {
            name: method[name].draw(proportions, frames[0]) for name in method if name in FIGURES
        }
        truth = self.population.truth[embedded[0]].double()
        sets = torch.from_numpy(method["features"].draw(proportions, embedded[0]))
        kernels = [metrics.KernelMatrices(truth, each) for each in sets]
        distances: dict[str, list[Callable[[np.ndarray], float]]] = {
            "fid": [partial(_fid, truth, each, self.population.scale) for each in sets],
            "kid": [each.kid for each in kernels],
        }
        unit = frames[1]
        return {
            "ssim": mean_replicates(drawn["ssim"], unit),
            "psnr": mean_replicates(drawn["psnr"], unit),
            "pose_error_mm": median_replicates(drawn["pose_error_mm"], unit),
        } | {name: set_replicates(each, embedded[1]) for name, each in distances.items()}

    def _score(self, replicates: dict[str, Replicates]) -> Replicates:
        zero, one = np.array([self.anchors[name] for name in RANKED]).T

        def anchored(values: np.ndarray) -> np.ndarray:
            turned = np.moveaxis(values, 0, -1)
            return ((turned - zero) / (one - zero)).mean(-1)

        return combine(anchored, [replicates[name] for name in RANKED])


def _trainings(method: Method, other: Method) -> dict[str, Trainings]:
    """Return the trainings of a method, by figure and of its features."""
    of = {name: Trainings.of(method.figures[name], other.figures[name]) for name in FIGURES}
    features = method.features.double().numpy(), other.features.double().numpy()
    return of | {"features": Trainings.of(*features)}


def _gather(places: list[np.ndarray], picks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (n,) items of the picked trajectories, and which pick each is of."""
    lengths = [len(places[pick]) for pick in picks]
    return np.concatenate([places[pick] for pick in picks]), np.repeat(
        np.arange(len(picks)), lengths
    )


def _sweeps(values: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return the (R, U) means of (R, N) values over the units."""
    starts = np.flatnonzero(np.diff(unit, prepend=-1))
    return np.add.reduceat(values, starts, axis=1) / np.diff(starts, append=len(unit))


def _fid(truth: Tensor, drawn: Tensor, scale: float, keep: np.ndarray) -> float:
    kept = torch.from_numpy(keep)
    return scale * metrics.fid(drawn[kept], truth[kept])
