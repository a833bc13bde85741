"""Scores of a generator on held-out poses: each number with n, an interval and its provenance."""

import dataclasses
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.store.frames import Batch, FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.report import compare
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.pose.training import pose_errors
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, Sample, draw, evenly, speed, take_sample
from racines_models.scores import diversity, metrics
from racines_models.scores.features import (
    Extractor,
    GraderFeatures,
    InceptionFeatures,
    features_of_sets,
    kept,
    reference_features,
)
from racines_models.scores.plugin import Metric, installed_metrics
from racines_models.statistics import (
    Estimate,
    bootstrap_mean,
    bootstrap_median,
    jackknife,
    jackknife_all,
)

SCHEMA = "racines.generator-scores/1"
NOTES = [
    "FID is biased upwards by small n: compare only figures of equal n, extractor and dataset.",
    "Intervals resample or leave out whole trajectories; none is given for one trajectory.",
]
PRDC_FRAMES = 4096
"""Most frames whose distances to one another are held at once."""
GRAY = "gray levels"


@dataclass(frozen=True)
class ScoresConfig:
    """How generators are scored."""

    samples: int = 256
    """At most so many frames of the split, spread evenly over its trajectories."""
    seeds: tuple[int, ...] = (0,)
    """One set of images each; figures are averaged over them, n counts frames."""
    split: str = "test"
    resamples: int = 1000
    """Bootstrap resamples of per-image figures."""
    blocks: int = 20
    """Most blocks of trajectories that the jackknife of FID and KID leaves out in turn."""
    kid_subset: int = 4096
    """Largest set of one KID estimate; beyond it, estimates of random subsets are averaged."""
    kid_subsets: int = 100
    speed: bool = True
    """Measure images a second at batch 1 and 64."""


@dataclass(frozen=True)
class Scores:
    """The scores file's content, and the images it speaks of."""

    content: dict[str, Any]
    sample: Sample
    images: Tensor
    """(N, 128, 128) uint8, drawn with the first seed."""


def score(
    generator: ImageSource | Sequence[ImageSource],
    store: FrameStore,
    config: ScoresConfig,
    name: str,
    grader: Grader | None = None,
    pose: PoseRegressor | None = None,
    seeds: Sequence[int] | None = None,
    cache: Path | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Scores:
    """Score a generator on a split of a dataset.

    Args:
        generator: Anything that makes images of parameters; or the same method trained with
            several seeds, which take the drawing seeds in turn. Figures are means over the sets.
        store: Holds the true frames.
        config: Sample size, seeds, split and intervals.
        name: The generator's name in the scores.
        grader: Adds its agreement with the truth, and FID, KID and PRDC on its features.
        pose: Adds the errors of the poses that it reads from the images.
        seeds: Instead of those of the config.
        cache: Folder for what is computed of the reference alone.
        device: Where features are computed.
        progress: Told of images drawn and images embedded, as they come.

    Raises:
        RacinesError: an empty split, or images that cannot be scored.
    """
    began = time.perf_counter()
    seeds = tuple(config.seeds if seeds is None else seeds)
    if not seeds:
        raise RacinesError("scores.seeds: give one seed or more")
    sample = take_sample(store, config.split, config.samples)
    runs = list(generator) if isinstance(generator, Sequence) else [generator]
    turns = take_turns(runs, seeds)
    seeds = tuple(seed for _, seed in turns)
    drawn = [draw(each, sample.frames, seed, progress) for each, seed in turns]
    scorer = Scorer(config, store, sample, drawn, cache, progress)
    extractors: dict[str, Extractor] = {"inception": InceptionFeatures(device)}
    figures = scorer.likeness() | scorer.distances("", extractors["inception"])
    if grader is not None:
        extractors["grader"] = GraderFeatures(grader)
        figures |= scorer.distances("_grader", extractors["grader"]) | scorer.agreement(grader)
    if pose is not None:
        figures |= scorer.poses(pose)
    figures |= scorer.variety(runs[0], seeds, len(runs)) | scorer.memory()
    figures |= scorer.plugged(extractors["inception"], figures)
    if config.speed and hasattr(runs[0], "generate"):
        for batch in (1, 64):
            rate = round(speed(runs[0], sample.frames, batch), 1)
            rule = f"best of 5 calls at batch {batch}"
            figures[f"images_per_second_{batch}"] = plain(rate, batch, "images/s", rule=rule)
    content = {
        "schema": SCHEMA,
        "generator": name,
        "dataset": dataset_card(store) | {"split": config.split, "sample": sample.digest},
        "seeds": list(seeds),
        "runs": len(runs),
        "metrics": figures,
        "extractors": {key: extractor.settings for key, extractor in extractors.items()}
        | ({} if pose is None else {"pose": pose.settings}),
        "weights": None,
        "code": code_version(),
        "environment": environment(device),
        "seconds": round(time.perf_counter() - began, 3),
        "notes": NOTES,
    }
    return Scores(content, sample, drawn[0])


def take_turns(runs: Sequence[ImageSource], seeds: Sequence[int]) -> list[tuple[ImageSource, int]]:
    """Return which run draws with which seed: each run at least once, each seed at least once.

    A method that draws the same whatever the seed draws once a run.
    """
    card = getattr(runs[0], "card", None)
    wanted = len(runs) if card is not None and not card.stochastic else max(len(runs), len(seeds))
    last = max(seeds)
    longer = [*seeds, *range(last + 1, last + 1 + wanted)][:wanted]
    return [(runs[k % len(runs)], seed) for k, seed in enumerate(longer)]


@dataclass
class Scorer:
    """One sample, its truth, and the images drawn of it with each seed."""

    config: ScoresConfig
    store: FrameStore
    sample: Sample
    drawn: list[Tensor]
    cache: Path | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        """Name the reference; figures of the truth itself say what a network's own errors allow."""
        self._key = [self.store.manifest["digest"], self.sample.digest]
        self._sides = {"": self.drawn, "_truth": [self.sample.frames.images]}

    def likeness(self) -> dict[str, Any]:
        """Return SSIM, MS-SSIM and PSNR against the frame at the same pose."""
        truth, figures = self.sample.frames.images, {}
        for name, metric, settings, unit in (
            ("ssim", metrics.ssim, metrics.SSIM_SETTINGS, None),
            ("ms_ssim", metrics.ms_ssim, metrics.MS_SSIM_SETTINGS, None),
            ("psnr", metrics.psnr, metrics.PSNR_SETTINGS, "dB"),
        ):
            values = [metric(images, truth) for images in self.drawn]
            means = [float(each.double().mean()) for each in values]
            by_set = {"by_set": means} if len(means) > 1 else {}
            figures[name] = self._mean(values).to_json(unit, **settings, **by_set)
        return figures

    def distances(self, suffix: str, extractor: Extractor) -> dict[str, Any]:
        """Return FID, KID and PRDC between the sets of drawn and true images."""
        name, config = extractor.settings["id"], self.config
        truth, drawn = self._features(extractor)
        clusters, blocks = self.sample.trajectory, config.blocks
        subsets: dict[str, Any] = {"subset": config.kid_subset, "subsets": config.kid_subsets}
        frechet = jackknife(_over_sets(metrics.fid, truth, drawn), clusters, blocks, 0.0)
        kernel = jackknife(self._kid(truth, drawn), clusters, blocks)
        figures = {
            f"fid{suffix}": frechet.to_json(features=name),
            f"kid{suffix}": kernel.to_json(features=name, **metrics.KID_SETTINGS, **subsets),
        }
        for key, each in self._neighbours(truth, drawn).items():
            figures[f"{key}{suffix}"] = each.to_json(features=name, **metrics.PRDC_SETTINGS)
        return figures

    def _kid(self, truth: Tensor, drawn: list[Tensor]) -> Callable[[np.ndarray], float]:
        subset, subsets = self.config.kid_subset, self.config.kid_subsets
        if len(truth) > subset:
            return _over_sets(partial(metrics.kid, subset=subset, subsets=subsets), truth, drawn)
        sets = [metrics.KernelMatrices(truth, each) for each in drawn]
        return lambda keep: float(np.mean([each.kid(keep) for each in sets]))

    def _features(self, extractor: Extractor) -> tuple[Tensor, list[Tensor]]:
        """Return the (N, D) features of the truth and of each drawn set."""
        images = self.sample.frames.images
        truth = reference_features(extractor, images, self._key, self.cache, self.progress)
        return truth, features_of_sets(extractor, self.drawn, self.progress)

    def _neighbours(self, truth: Tensor, drawn: list[Tensor]) -> dict[str, Estimate]:
        if len(truth) <= metrics.NEIGHBOURS:
            return {}
        rows = evenly(len(truth), PRDC_FRAMES)
        sets = [metrics.Neighbourhoods(truth[rows], each[rows]) for each in drawn]

        def statistics(keep: np.ndarray) -> dict[str, float]:
            figures = [each.figures(keep) for each in sets]
            return {name: float(np.mean([each[name] for each in figures])) for name in figures[0]}

        trajectory = self.sample.trajectory[rows.numpy()]
        estimates = jackknife_all(statistics, trajectory, self.config.blocks, 0.0)
        for name, each in estimates.items():
            if name != "density" and each.high is not None:
                estimates[name] = dataclasses.replace(each, high=min(each.high, 1.0))
        return estimates

    def agreement(self, grader: Grader) -> dict[str, Any]:
        """Return how the grader's view and grade of the images agree with the truth."""
        frames, figures = self.sample.frames, {}
        grader.check_labels(self.store.labels, "the dataset")
        random = len(grader.labels) - 1
        for suffix, sets in self._sides.items():
            judged = [grader.judge(images)[:2] for images in sets]
            compared = [compare(*each, frames.views, frames.grades, random) for each in judged]
            for name, first in compared[0].items():
                estimate = self._mean([each[name].values for each in compared])
                figures[f"{name}{suffix}"] = estimate.to_json(first.unit, rule=first.rule)
        return figures

    def poses(self, regressor: PoseRegressor) -> dict[str, Any]:
        """Return the median errors of the poses that a regressor reads from the images.

        `…_view` is over the frames of a view: there is something to be seen.
        """
        frames, figures = self.sample.frames, {}
        of_view = (frames.views >= 0) & (frames.views != len(self.store.labels) - 1)
        groups = {"": (torch.ones_like(of_view), "all frames")}
        groups["_view"] = (of_view, "the frames of a view")
        for suffix, sets in self._sides.items():
            found = [pose_errors(regressor.predict(images), frames.parameters) for images in sets]
            for group, (chosen, rule) in groups.items():
                if not bool(chosen.any()):
                    continue
                for unit, errors in zip(("mm", "deg"), zip(*found, strict=True), strict=True):
                    median = self._median([each[chosen] for each in errors], chosen)
                    name = f"pose_error_{unit}{group}{suffix}"
                    figures[name] = median.to_json(unit, rule=f"median over {rule}")
        return figures

    def variety(
        self, generator: ImageSource, seeds: tuple[int, ...], runs: int = 1
    ) -> dict[str, Any]:
        """Return the share of images that differ from all others, and how draws of a pose differ.

        `distinct` is 1/n where one image fits all poses. `diversity_truth` is what the source's own
        noise does: there for phantoms, which can be scanned again.
        """
        images = self.drawn[0].flatten(1).numpy()
        share = len(np.unique(images, axis=0)) / len(images)
        figures = {"distinct": plain(share, len(images), rule="images that differ, first seed")}
        frames = self.sample.frames
        # Of several trained runs only the first: two runs differ by more than their noise.
        again = diversity.drawn_again(generator, frames, self.drawn[::runs], seeds[::runs])
        if again is not None:
            sets, places = again
            rule = "root mean square difference of two draws of one pose"
            told = self._mean([diversity.spread(sets)], places)
            figures["diversity"] = told.to_json(GRAY, rule=rule, draws=len(sets))
        places = evenly(len(frames.index), diversity.FRAMES)
        some = Batch(*(column[places] for column in frames))
        scanned = diversity.scanned_again(self.store, some, self.cache)
        if scanned is not None:
            rule = "root mean square difference of two new scans of one pose"
            told, source = self._mean([scanned], places), self.store.manifest["source"]
            figures["diversity_truth"] = told.to_json(GRAY, rule=rule, source=source)
        return figures

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
            copies = self._mean([(each < diversity.COPY).double() for each in nearest])
            figures[f"nearest_train{suffix}"] = self._median(nearest).to_json(GRAY, rule=apart)
            figures[f"copies{suffix}"] = copies.to_json(rule=same)
        return figures

    def plugged(self, extractor: Extractor, taken: Collection[str] = ()) -> dict[str, Any]:
        """Return the metrics of installed packages; the extractor serves those of features."""
        figures: dict[str, Any] = {}
        for metric in installed_metrics():
            if metric.name in taken:
                raise RacinesError(f"metric {metric.name!r}: rename it, there is one of that name")
            told = {"rule": metric.rule} if metric.rule else {}
            if metric.features:
                statistic = _over_sets(metric.measure, *self._features(extractor))
                estimate = jackknife(statistic, self.sample.trajectory, self.config.blocks)
            else:
                estimate = self._of_images(metric)
            figures[metric.name] = estimate.to_json(metric.unit or None, **told)
        return figures

    def _of_images(self, metric: Metric) -> Estimate:
        frames = self.sample.frames
        pairs = [(frames._replace(images=images), frames) for images in self.drawn]
        values = [torch.as_tensor(metric.measure(*pair)) for pair in pairs]
        if any(each.shape != (len(frames.index),) for each in values):
            raise RacinesError(f"metric {metric.name!r}: it has to give one value an image")
        return self._mean(values)

    def _mean(self, values: list[Tensor], places: Tensor | None = None) -> Estimate:
        average = torch.stack(values).double().mean(0).numpy()
        trajectory = self._trajectory(places)
        return bootstrap_mean(average, trajectory, resamples=self.config.resamples)

    def _median(self, values: list[Tensor], chosen: Tensor | None = None) -> Estimate:
        """Return the median over frames and seeds together; n counts frames."""
        trajectory = self._trajectory(chosen)
        pooled = torch.cat(values).double().numpy()
        clusters = np.tile(trajectory, len(values))
        median = bootstrap_median(pooled, clusters, resamples=self.config.resamples)
        return dataclasses.replace(median, n=len(trajectory))

    def _trajectory(self, frames: Tensor | None) -> np.ndarray:
        return self.sample.trajectory if frames is None else self.sample.trajectory[frames.numpy()]


def _over_sets(
    statistic: Callable[[Tensor, Tensor], Any], truth: Tensor, drawn: list[Tensor]
) -> Callable[[np.ndarray], float]:
    """Return the mean of a statistic over the drawn sets, as a function of the samples kept."""

    def mean(keep: np.ndarray) -> float:
        rows = torch.from_numpy(keep)
        return float(np.mean([float(statistic(each[rows], truth[rows])) for each in drawn]))

    return mean


def plain(value: float, n: int, unit: str | None = None, **settings: Any) -> dict[str, Any]:
    """Return a figure without an interval as it stands in a scores file."""
    figure = {"value": value, "low": None, "high": None, "n": n, "settings": settings}
    return figure | ({"unit": unit} if unit else {})
