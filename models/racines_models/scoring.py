"""Scores of a generator on held-out poses: each number with n, an interval and its provenance."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.store import FrameStore
from racines_models import metrics
from racines_models.bootstrap import Estimate, bootstrap_mean, jackknife
from racines_models.features import Extractor, GraderFeatures, reference_features
from racines_models.grader import Grader
from racines_models.grader_report import compare
from racines_models.inception import InceptionFeatures
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, Sample, draw, speed, take_sample

SCHEMA = "racines.generator-scores/1"


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
    kid_subset: int = 1000
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
    generator: ImageSource,
    store: FrameStore,
    config: ScoresConfig,
    name: str,
    grader: Grader | None = None,
    seeds: Sequence[int] | None = None,
    cache: Path | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Scores:
    """Score a generator on a split of a dataset.

    Args:
        generator: Anything that makes images of parameters.
        store: The dataset.
        config: Sample size, seeds, split and intervals.
        name: The generator's name in the scores.
        grader: Adds its agreement with the truth, and FID and KID on its features.
        seeds: Instead of those of the config.
        cache: Folder for the reference's Inception features.
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
    drawn = [draw(generator, sample.frames, seed, progress) for seed in seeds]
    judge = _Judge(config, store, sample, drawn, cache, progress)
    extractors: dict[str, Extractor] = {"inception": InceptionFeatures(device)}
    figures = judge.likeness() | judge.distances("", extractors["inception"])
    if grader is not None:
        extractors["grader"] = GraderFeatures(grader)
        figures |= judge.distances("_grader", extractors["grader"]) | judge.agreement(grader)
    figures |= judge.variety()
    if config.speed and hasattr(generator, "generate"):
        figures |= {f"images_per_second_{n}": _rate(generator, sample, n) for n in (1, 64)}
    content = {
        "schema": SCHEMA,
        "generator": name,
        "dataset": dataset_card(store) | {"split": config.split, "sample": sample.digest},
        "seeds": list(seeds),
        "metrics": figures,
        "extractors": {key: extractor.settings for key, extractor in extractors.items()},
        "weights": None,
        "code": code_version(),
        "environment": environment(device),
        "seconds": round(time.perf_counter() - began, 3),
        "notes": NOTES,
    }
    return Scores(content, sample, drawn[0])


NOTES = [
    "FID is biased upwards by small n: compare only figures of equal n, extractor and dataset.",
    "Intervals resample or leave out whole trajectories; none is given for one trajectory.",
]


class _Judge:
    """One sample, its truth, and the images drawn of it with each seed."""

    def __init__(
        self,
        config: ScoresConfig,
        store: FrameStore,
        sample: Sample,
        drawn: list[Tensor],
        cache: Path | None,
        progress: Progress | None,
    ) -> None:
        self.config, self.store, self.sample, self.drawn = config, store, sample, drawn
        self.cache, self.progress = cache, progress

    def likeness(self) -> dict[str, Any]:
        """Return SSIM and PSNR against the frame at the same pose."""
        truth = self.sample.frames.images
        ssim = self._mean([metrics.ssim(images, truth) for images in self.drawn])
        psnr = self._mean([metrics.psnr(images, truth) for images in self.drawn])
        return {
            "ssim": ssim.to_json(**metrics.SSIM_SETTINGS),
            "psnr": psnr.to_json("dB", **metrics.PSNR_SETTINGS),
        }

    def distances(self, suffix: str, extractor: Extractor) -> dict[str, Any]:
        """Return FID and KID between the sets of drawn and true images."""
        name = extractor.settings["id"]
        key = [self.store.manifest["digest"], self.sample.digest]
        truth = reference_features(
            extractor, self.sample.frames.images, key, self.cache, self.progress
        )
        drawn = [extractor(images, self.progress) for images in self.drawn]
        config = self.config

        def averaged(metric: Callable[[Tensor, Tensor], float]) -> Callable[[np.ndarray], float]:
            def statistic(keep: np.ndarray) -> float:
                rows = torch.from_numpy(keep)
                return float(np.mean([metric(each[rows], truth[rows]) for each in drawn]))

            return statistic

        def kid(a: Tensor, b: Tensor) -> float:
            return metrics.kid(a, b, config.kid_subset, config.kid_subsets)

        subsets: dict[str, Any] = {"subset": config.kid_subset, "subsets": config.kid_subsets}
        fid = jackknife(averaged(metrics.fid), self.sample.trajectory, config.blocks, 0.0)
        distance = jackknife(averaged(kid), self.sample.trajectory, config.blocks)
        return {
            f"fid{suffix}": fid.to_json(features=name),
            f"kid{suffix}": distance.to_json(features=name, **metrics.KID_SETTINGS, **subsets),
        }

    def agreement(self, grader: Grader) -> dict[str, Any]:
        """Return how the grader's view and grade of the drawn images agree with the truth.

        The same figures of the true images (`…_truth`) say what the grader's own errors allow.
        """
        frames, figures = self.sample.frames, {}
        grader.check_labels(self.store.labels, "the dataset")
        random = len(grader.labels) - 1
        for suffix, sets in (("", self.drawn), ("_truth", [frames.images])):
            compared = [
                compare(*grader.judge(images)[:2], frames.views, frames.grades, random)
                for images in sets
            ]
            for name, first in compared[0].items():
                estimate = self._mean([each[name].values for each in compared])
                figures[f"{name}{suffix}"] = estimate.to_json(first.unit, rule=first.rule)
        return figures

    def variety(self) -> dict[str, Any]:
        """Return the share of images that differ from all others: 1/n where one fits all poses."""
        images = self.drawn[0].flatten(1).numpy()
        share = len(np.unique(images, axis=0)) / len(images)
        return {"distinct": _plain(share, len(images), rule="images that differ, first seed")}

    def _mean(self, values: list[Tensor]) -> Estimate:
        average = torch.stack(values).double().mean(0).numpy()
        return bootstrap_mean(average, self.sample.trajectory, resamples=self.config.resamples)


def _rate(generator: ImageSource, sample: Sample, batch: int) -> dict[str, Any]:
    rate = round(speed(generator, sample.frames, batch), 1)
    return _plain(rate, batch, "images/s", rule=f"best of 5 calls at batch {batch}")


def _plain(value: float, n: int, unit: str | None = None, **settings: Any) -> dict[str, Any]:
    figure = {"value": value, "low": None, "high": None, "n": n, "settings": settings}
    return figure | ({"unit": unit} if unit else {})
