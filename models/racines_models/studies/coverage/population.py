"""What studies are drawn from: the figures of two methods on all trajectories of a dataset.

The trajectories of all splits serve, since nothing is scored here: they are a population of units
with the skewness, the unequal lengths and the likeness of neighbouring frames of the real ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_atomic
from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.pose.training import pose_errors
from racines_models.provenance import sha256_bytes
from racines_models.sample import Progress, Sample, draw, spread_sample
from racines_models.scores import metrics
from racines_models.scores.features import Extractor, features_of_sets

FIGURES = ("ssim", "psnr", "pose_error_mm")
"""Of each frame."""


@dataclass(frozen=True)
class Method:
    """One method on N frames, M of which have features."""

    figures: dict[str, np.ndarray]
    """(R, N) each, of R trainings; by the names in `FIGURES`."""
    features: Tensor
    """(R, M, D) float32."""


@dataclass(frozen=True)
class Population:
    """Two methods on the same frames of K trajectories."""

    unit: np.ndarray
    """(N,) the trajectory of each frame, 0 to K - 1, in order."""
    embedded: np.ndarray
    """(M,) which of the frames have features, in order."""
    truth: Tensor
    """(M, D) features of the true frames."""
    first: Method
    second: Method
    scale: float = 1.0
    """By which a squared distance of features is to be multiplied, after `project`."""

    @property
    def units(self) -> int:
        """Number of trajectories, K."""
        return int(self.unit[-1]) + 1

    def project(self, dimensions: int, seed: int) -> "Population":
        """Return the population with features in a random subspace; 0 dimensions keeps all.

        The axes are orthonormal; `scale` says how much of a squared distance they leave out.
        """
        if not dimensions:
            return self
        generator = torch.Generator().manual_seed(seed)
        drawn = torch.randn(self.truth.shape[1], dimensions, generator=generator)
        axes = torch.linalg.qr(drawn).Q
        first, second = (
            Method(each.figures, each.features @ axes) for each in (self.first, self.second)
        )
        scale = len(axes) / dimensions
        return Population(self.unit, self.embedded, self.truth @ axes, first, second, scale)


def measure(
    store: FrameStore,
    first: Sequence[ImageSource],
    second: Sequence[ImageSource],
    extractor: Extractor,
    pose: PoseRegressor,
    size: tuple[int, int],
    key: Sequence[Any],
    cache: Path | None = None,
    progress: Progress | None = None,
) -> Population:
    """Draw the frames of all trajectories with two methods and measure each.

    Args:
        store: All its trajectories are taken.
        first: The trainings of the first method.
        second: Those of the second.
        extractor: Embeds images for FID and KID.
        pose: Reads poses from images.
        size: Frames that are measured, and how many of them are embedded.
        key: Names the two methods in the cache: hashes of their weights.
        cache: Folder that keeps what was measured.
        progress: Told of images drawn and embedded.

    Raises:
        RacinesError: fewer than two trajectories.
    """
    sample = spread_sample(store, torch.arange(len(store.images)), size[0])
    names, unit = np.unique(sample.trajectory, return_inverse=True)
    if len(names) < 2:
        raise RacinesError("coverage: the dataset has one trajectory; studies are drawn of several")
    embedded = np.arange(min(size[1], len(unit))) * len(unit) // min(size[1], len(unit))
    told = [store.manifest["digest"], sample.digest, size, list(key), extractor.settings]
    name = sha256_bytes(repr([*told, pose.settings, torch.__version__]).encode())[:32]
    path = None if cache is None else cache / f"coverage-{name}.safetensors"
    if path is not None and path.is_file():
        held = read_tensors(path)
        if progress is not None:
            progress(images_drawn(store, size, len(first) + len(second)))
    else:
        held = _measure(sample, (first, second), extractor, pose, embedded, progress)
        if path is not None:
            write_atomic(path, save(held))
    one, two = (
        Method({f: held[f"{side}.{f}"].numpy() for f in FIGURES}, held[f"{side}.features"])
        for side in ("first", "second")
    )
    return Population(unit, embedded, held["truth"], one, two)


def images_drawn(store: FrameStore, size: tuple[int, int], sets: int) -> int:
    """Return how many images are drawn of so many trainings and embedded, for the progress."""
    frames = min(size[0], len(store.images))
    return sets * frames + (sets + 1) * min(size[1], frames)


def _measure(
    sample: Sample,
    methods: tuple[Sequence[ImageSource], Sequence[ImageSource]],
    extractor: Extractor,
    pose: PoseRegressor,
    embedded: np.ndarray,
    progress: Progress | None,
) -> dict[str, Tensor]:
    truth, chosen, held = sample.frames.images, torch.from_numpy(embedded), {}
    sets = [truth[chosen]]
    for side, runs in zip(("first", "second"), methods, strict=True):
        figures: dict[str, list[Tensor]] = {name: [] for name in FIGURES}
        for run in runs:
            images = draw(run, sample.frames, 0, progress)
            found = pose_errors(pose.predict(images), sample.frames.parameters)[0]
            each = (metrics.ssim(images, truth), metrics.psnr(images, truth), found)
            for name, values in zip(FIGURES, each, strict=True):
                figures[name].append(values.double())
            sets.append(images[chosen])
        held |= {f"{side}.{name}": torch.stack(values) for name, values in figures.items()}
    features = features_of_sets(extractor, sets, progress)
    held["truth"], trainings = features[0], len(methods[0])
    held["first.features"] = torch.stack(features[1 : 1 + trainings])
    held["second.features"] = torch.stack(features[1 + trainings :])
    return held
