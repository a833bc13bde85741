"""The figures of one sample: each of its images, kept as evidence, and the interval they give."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.manifest import scale_known
from racines_data.store.frames import Batch, FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.report import MOST, compare
from racines_models.judges.pose.frames import parameters_in
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.pose.training import LARGEST, pose_errors
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.judges.segmentation.overlap import dice
from racines_models.judges.segmentation.structures import relabel, to_structures
from racines_models.sample import Progress, Sample, evenly, runs_of
from racines_models.scores import diversity, metrics
from racines_models.scores.features import (
    Extractor,
    features_of_sets,
    kept,
    reference_features,
)
from racines_models.scores.plugin import Metric, installed_metrics
from racines_models.statistics import Evidence, Figures, Replicates, set_replicates_all

PRDC_FRAMES = 4096
"""Most frames whose distances to one another are held at once."""
GRAY = "gray levels"
BLACK_TO_WHITE = (0.0, metrics.DATA_RANGE)
SHARE, AMOUNT, ANY = (0.0, 1.0), (0.0, np.inf), (-np.inf, np.inf)


@dataclass(frozen=True)
class ScoresConfig:
    """How generators are scored."""

    samples: int = 256
    """At most so many frames of the split, spread evenly over its trajectories."""
    seeds: tuple[int, ...] = (0,)
    """One set of images each; figures are averaged over them, n counts frames."""
    split: str = "test"
    resamples: int = 1000
    """Of no effect, as intervals leave trajectories out; read, since older files say it."""
    blocks: int = 20
    """Of no effect: all metrics share their blocks of trajectories, `statistics.intervals.BLOCKS`
    at most; read, since older files say it."""
    kid_subset: int = 4096
    """Largest set of one KID estimate; beyond it, estimates of random subsets are averaged."""
    kid_subsets: int = 100
    speed: bool = True
    """Measure images a second at batch 1 and 64."""
    grader: str = "models/runs/grader"
    """Run folder of the grader that judges. A board's is published, so that all are judged alike
    wherever they are scored."""
    pose: str = "models/runs/pose"
    """Run folder of the pose regressor; none if it is not there."""


@dataclass
class Scorer:
    """One sample, its truth, and the images drawn of it, of each training as many sets."""

    config: ScoresConfig
    store: FrameStore
    sample: Sample
    drawn: list[Tensor]
    """(N, 128, 128) uint8 each; the trainings have drawn them in turns."""
    cache: Path | None = None
    progress: Progress | None = None
    runs: int = 1
    """Trainings."""
    evidence: Evidence = field(default_factory=Evidence)
    """The figures behind all that was told so far."""
    measured: dict[str, list[Tensor]] = field(default_factory=dict)
    """(N,) values of each set by name, as far as they have been measured."""

    def __post_init__(self) -> None:
        """Name the reference; figures of the truth itself say what a network's own errors allow."""
        if not self.drawn or len(self.drawn) % self.runs:
            raise ValueError(f"{len(self.drawn)} sets of {self.runs} trainings: give each as many")
        self._key = [self.store.manifest["digest"], self.sample.digest]
        self._sides = {"": self.drawn, "_truth": [self.sample.frames.images]}

    def part(self, rows: Tensor) -> "Scorer":
        """Return a scorer of some (n,) of its rows, who measures nothing of them again."""
        own = self.sample.frames.index[rows]
        return Scorer(
            self.config, self.store, Sample(self.store.take(own), self.store.units(own)),
            [images[rows] for images in self.drawn], runs=self.runs,
            measured={name: [each[rows] for each in sets] for name, sets in self.measured.items()},
        )  # fmt: skip

    def measure(
        self, name: str, metric: Callable[[Tensor, Tensor], Tensor], sets: Sequence[Tensor]
    ) -> list[Tensor]:
        """Return (N,) values of a metric of each image and the frame at its pose, for each set.

        What has been measured by a name is not measured again.
        """
        if name not in self.measured:
            self.measured[name] = [metric(images, self.sample.frames.images) for images in sets]
        return self.measured[name]

    def likeness(self) -> dict[str, Any]:
        """Return SSIM, MS-SSIM and PSNR against the frame at the same pose."""
        figures = {}
        for name, metric, settings, ends, unit in (
            ("ssim", metrics.ssim, metrics.SSIM_SETTINGS, (-1.0, 1.0), None),
            ("ms_ssim", metrics.ms_ssim, metrics.MS_SSIM_SETTINGS, SHARE, None),
            ("psnr", metrics.psnr, metrics.PSNR_SETTINGS, (0.0, metrics.PSNR_CAP), "dB"),
        ):
            values = self.measure(name, metric, self.drawn)
            figures[name] = self.of_frames(name, "mean", values, ends, unit, **settings)
        return figures

    def distances(self, suffix: str, extractor: Extractor) -> dict[str, Any]:
        """Return FID, KID and PRDC between the sets of drawn and true images."""
        name, config = extractor.settings["id"], self.config
        truth, drawn = self.features(extractor)
        subsets: dict[str, Any] = {"subset": config.kid_subset, "subsets": config.kid_subsets}
        told = {"fid": (AMOUNT, {}), "kid": (ANY, metrics.KID_SETTINGS | subsets)}
        pairs = [self.fid_and_kid(truth, each) for each in drawn]
        found = self.of_sets(pairs, self.sample.trajectory)
        if len(truth) > metrics.NEIGHBOURS:
            rows = evenly(len(truth), PRDC_FRAMES)
            near = [metrics.Neighbourhoods(truth[rows], each[rows]).figures for each in drawn]
            found |= self.of_sets(near, self.sample.trajectory[rows.numpy()])
            shares = ("precision", "recall", "coverage")
            told |= dict.fromkeys(shares, (SHARE, metrics.PRDC_SETTINGS))
            told["density"] = (AMOUNT, metrics.PRDC_SETTINGS)
        return {
            f"{key}{suffix}": self.of_set(f"{key}{suffix}", each, ends, features=name, **settings)
            for key, each in found.items()
            for ends, settings in [told[key]]
        }

    def fid_and_kid(self, truth: Tensor, drawn: Tensor) -> Callable[[np.ndarray], dict[str, float]]:
        """Return FID and KID of one drawn set as a function of the samples kept."""
        frechet = metrics.CrossProducts(truth, drawn)
        subset, subsets = self.config.kid_subset, self.config.kid_subsets
        matrices = metrics.KernelMatrices(truth, drawn) if len(truth) <= subset else None

        def both(keep: np.ndarray) -> dict[str, float]:
            if matrices is not None:
                return {"fid": frechet.fid(keep), "kid": matrices.kid(keep)}
            rows = torch.from_numpy(keep)
            kernel = metrics.kid(drawn[rows], truth[rows], subset, subsets)
            return {"fid": frechet.fid(keep), "kid": kernel}

        return both

    def features(self, extractor: Extractor) -> tuple[Tensor, list[Tensor]]:
        """Return the (N, D) features of the truth and of each drawn set."""
        images = self.sample.frames.images
        truth = reference_features(extractor, images, self._key, self.cache, self.progress)
        return truth, features_of_sets(extractor, self.drawn, self.progress)

    def agreement(self, grader: Grader) -> dict[str, Any]:
        """Return how the grader's view and grade of the images agree with the truth."""
        frames, figures = self.sample.frames, {}
        grader.check_labels(self.store.labels, "the dataset")
        random = len(grader.labels) - 1
        for suffix, sets in self._sides.items():
            judged = [grader.judge(images)[:2] for images in sets]
            compared = [compare(*each, frames.views, frames.grades, random) for each in judged]
            for key, first in compared[0].items():
                values, name = [each[key].values for each in compared], f"{key}{suffix}"
                ends = (0.0, MOST if first.statistic == "mean" else 1.0)
                figures[name] = self.of_frames(
                    name, first.statistic, values, ends, first.unit, rule=first.rule
                )
        return figures

    def poses(self, regressor: PoseRegressor) -> dict[str, Any]:
        """Return the median errors of the poses that a regressor reads from the images.

        `…_view` is over the frames of a view: there is something to be seen. Where the scale of
        positions is unknown, nothing is told in millimetres.
        """
        frames, figures = self.sample.frames, {}
        of_view = (frames.views >= 0) & (frames.views != len(self.store.labels) - 1)
        groups = {"": (torch.ones_like(of_view), "all frames")}
        groups["_view"] = (of_view, "the frames of a view")
        true = parameters_in(regressor.config.frame, self.store, frames.index)
        for suffix, sets in self._sides.items():
            found = [pose_errors(regressor.predict(images), true) for images in sets]
            for group, (chosen, rule) in groups.items():
                if not bool(chosen.any()):
                    continue
                for unit, errors in zip(LARGEST, zip(*found, strict=True), strict=True):
                    if unit == "mm" and not scale_known(self.store.manifest):
                        continue
                    name, told = f"pose_error_{unit}{group}{suffix}", f"median over {rule}"
                    values = [each.where(chosen, torch.nan) for each in errors]
                    ends = (0.0, LARGEST[unit])
                    figures[name] = self.of_frames(name, "median", values, ends, unit, rule=told)
        return figures

    def overlap(
        self, judge: SegmentationJudge, masks: Tensor, labels: Sequence[str]
    ) -> dict[str, Any]:
        """Return the Dice of what the judge outlines in the images with the true masks.

        The mean over the structures that the true mask has, and each of them; `…_truth` is of what
        it outlines in the true frames: what the judge's own errors cost.

        Args:
            judge: outlines chambers and walls.
            masks: (N, 128, 128) uint8, the true ones of the sample's frames.
            labels: names of their numbers.
        """
        names, figures = judge.structures, {}
        truth = relabel(masks, to_structures(labels, names))
        rule = "judge's outline in the image, true mask of the frame"
        for suffix, sets in self._sides.items():
            found = [dice(judge.segment(each), truth, len(names)) for each in sets]
            parts = {"dice": [each.nanmean(1) for each in found]}
            for place, name in enumerate(names):
                key = f"dice_{name.lower().replace(' ', '_')}"
                parts |= {key: [each[:, place] for each in found]}
            for key, values in parts.items():
                if bool(values[0].isfinite().any()):
                    figures[f"{key}{suffix}"] = self.of_frames(
                        f"{key}{suffix}", "mean", values, SHARE, rule=rule
                    )
        return figures

    def variety(
        self, generator: ImageSource | Sequence[ImageSource], seeds: Sequence[int]
    ) -> dict[str, Any]:
        """Return the share of images that differ from all others, and how draws of a pose differ.

        `distinct` is 1/n where one image fits all poses. `diversity_truth` is what the source's own
        noise does: there for phantoms, which can be scanned again.
        """
        images = self.drawn[0].flatten(1).numpy()
        share = len(np.unique(images, axis=0)) / len(images)
        figures = {"distinct": plain(share, len(images), rule="images that differ, first seed")}
        frames, runs = self.sample.frames, runs_of(generator)
        # Each training apart: two trainings differ by more than their noise.
        again = [
            diversity.drawn_again(
                run, frames, self.drawn[k :: self.runs], tuple(seeds[k :: self.runs])
            )
            for k, run in enumerate(runs)
        ]
        drawn = [each for each in again if each is not None]
        if len(drawn) == len(runs):
            told = {"rule": "root mean square difference of two draws of one pose"}
            told |= {"draws": len(drawn[0][0])}
            values = [self._placed(diversity.spread(sets), places) for sets, places in drawn]
            ends = BLACK_TO_WHITE
            figures["diversity"] = self.of_frames("diversity", "mean", values, ends, GRAY, **told)
        places = evenly(len(frames.index), diversity.FRAMES)
        some = Batch(*(column[places] for column in frames))
        scanned = diversity.scanned_again(self.store, some, self.cache)
        if scanned is not None:
            told = {"rule": "root mean square difference of two new scans of one pose"}
            told |= {"source": self.store.manifest["source"]}
            name, values = "diversity_truth", [self._placed(scanned, places)]
            figures[name] = self.of_frames(name, "mean", values, BLACK_TO_WHITE, GRAY, **told)
        return figures

    def _placed(self, values: Tensor, places: Tensor) -> Tensor:
        """Return (N,) values of all frames, NaN but at (n,) places, of (n,) values there."""
        every = torch.full((len(self.sample.frames.index),), torch.nan, dtype=torch.float64)
        every[places] = values.double()
        return every

    def memory(self) -> dict[str, Any]:
        """Return how far the nearest training image is, and the share of copies of one."""
        if not len(self.store.split_indices("train")):
            return {}
        key = ["train summaries", self._key[0], diversity.BLOCK]
        train = kept(self.cache, key, lambda: diversity.summarise_train(self.store).half())
        apart = "root mean square difference to the nearest training image, median"
        same = f"the nearest training image differs by less than {diversity.COPY:g} {GRAY}"
        figures = {}
        for suffix, sets in self._sides.items():
            nearest = [diversity.nearest_train(each, self.store, train) for each in sets]
            copied = [(each < diversity.COPY).double() for each in nearest]
            for name, statistic, values, ends, unit, rule in (
                (f"nearest_train{suffix}", "median", nearest, BLACK_TO_WHITE, GRAY, apart),
                (f"copies{suffix}", "rate", copied, SHARE, None, same),
            ):
                figures[name] = self.of_frames(name, statistic, values, ends, unit, rule=rule)
        return figures

    def plugged(self, extractor: Extractor, taken: Collection[str] = ()) -> dict[str, Any]:
        """Return the metrics of installed packages; the extractor serves those of features."""
        figures: dict[str, Any] = {}
        for metric in installed_metrics():
            if metric.name in taken:
                raise RacinesError(f"metric {metric.name!r}: rename it, there is one of that name")
            rule = {"rule": metric.rule} if metric.rule else {}
            told = ((metric.minimum, metric.maximum), metric.unit or None)
            if metric.features:
                measured = [_measured(metric, *pair) for pair in self._pairs(extractor)]
                found = self.of_sets(measured, self.sample.trajectory)[metric.name]
                if not np.isfinite([*found.whole, *found.without.ravel()]).all():
                    raise RacinesError(f"metric {metric.name!r}: its value is not finite")
                figures[metric.name] = self.of_set(metric.name, found, *told, **rule)
            else:
                values = self._of_images(metric)
                figures[metric.name] = self.of_frames(metric.name, "mean", values, *told, **rule)
        return figures

    def _pairs(self, extractor: Extractor) -> list[tuple[Tensor, Tensor]]:
        truth, drawn = self.features(extractor)
        return [(each, truth) for each in drawn]

    def _of_images(self, metric: Metric) -> list[Tensor]:
        frames = self.sample.frames
        pairs = [(frames._replace(images=images), frames) for images in self.drawn]
        values = [torch.as_tensor(metric.measure(*pair)) for pair in pairs]
        if any(each.shape != (len(frames.index),) for each in values):
            raise RacinesError(f"metric {metric.name!r}: it has to give one value an image")
        if not all(bool(each.isfinite().any()) for each in values):
            raise RacinesError(f"metric {metric.name!r}: it has no value of any image")
        return values

    def of_frames(
        self,
        name: str,
        statistic: str,
        values: list[Tensor],
        ends: tuple[float, float],
        unit: str | None = None,
        **settings: Any,
    ) -> dict[str, Any]:
        """Keep (N,) values of each drawn set, or of the truth; return the figure as JSON."""
        frames, runs = self.sample.frames.index.numpy(), min(self.runs, len(values))
        of_sets = torch.stack(values).double().numpy()
        by_training = of_sets.reshape(-1, runs, len(frames)).swapaxes(0, 1)
        trajectory = self.sample.trajectory
        kept = self.evidence.add(name, statistic, by_training, frames, trajectory, *ends)
        return _as_json(kept, unit, settings)

    def of_sets(
        self, statistics: Sequence[Callable[[np.ndarray], Mapping[str, float]]], units: np.ndarray
    ) -> dict[str, Replicates]:
        """Return the replicates of statistics of each drawn set; of a training, their means.

        Of fewer sets than trainings, such as one of true frames, each counts as a training.
        """
        runs = min(self.runs, len(statistics))

        def of_training(keep: np.ndarray, k: int) -> dict[str, float]:
            found = [each(keep) for each in statistics[k::runs]]
            return {name: float(np.mean([each[name] for each in found])) for name in found[0]}

        trainings = [lambda keep, k=k: of_training(keep, k) for k in range(runs)]
        return set_replicates_all(trainings, units)

    def of_set(
        self,
        name: str,
        found: Replicates,
        ends: tuple[float, float],
        unit: str | None = None,
        **settings: Any,
    ) -> dict[str, Any]:
        """Keep the replicates of a metric of whole sets; return the figure as JSON."""
        return _as_json(self.evidence.add_set(name, found, *ends), unit, settings)


def _as_json(figures: Figures, unit: str | None, settings: dict[str, Any]) -> dict[str, Any]:
    """Return a figure as JSON; of several trainings, with the value of each."""
    told, whole = figures.interval(), figures.replicates().whole
    by_set = {"by_set": whole.tolist()} if len(whole) > 1 else {}
    return told.to_json(unit, **settings, **by_set)


def _measured(
    metric: Metric, drawn: Tensor, truth: Tensor
) -> Callable[[np.ndarray], dict[str, float]]:
    """Return a metric of features as a function of the samples kept."""

    def measure(keep: np.ndarray) -> dict[str, float]:
        rows = torch.from_numpy(keep)
        return {metric.name: float(metric.measure(drawn[rows], truth[rows]))}

    return measure


def plain(value: float, n: int, unit: str | None = None, **settings: Any) -> dict[str, Any]:
    """Return a figure without an interval as it stands in a scores file."""
    figure = {"value": value, "low": None, "high": None, "n": n, "settings": settings}
    return figure | ({"unit": unit} if unit else {})
