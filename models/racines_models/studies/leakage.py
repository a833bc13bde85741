"""Whether held-out trajectories leak, and how much a random split of frames would flatter.

Nearest-pose retrieval draws nothing: it hands back the training frame whose pose is nearest. Under
a split by trajectory it has to find a frame of another sweep. Under a random split of frames the
neighbours in time of every test frame are in the training set, and it hands back a near-copy.

The same frames are looked up under both splits. Only where they may be found differs, so that the
difference of SSIM and PSNR is the leak.

Beside it stands the audit of every held-out trajectory (`racines_data.validate.leaks`).
"""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.manifest import scale_known
from racines_data.store.frames import FrameStore
from racines_data.validate.leaks import find_leaks, leaks_json
from racines_models.generators.nearest_pose import NearestPose, NearestPoseConfig
from racines_models.judges.pose.training import pose_errors
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, Sample, spread_sample
from racines_models.scores import metrics
from racines_models.statistics import mean_interval

SCHEMA = "racines.leakage/1"
CHUNK = 256
"""Poses looked up between two steps of the progress bar."""
UNITS = {"ssim": None, "psnr": "dB"}


@dataclass(frozen=True)
class LeakageConfig:
    """How the leak is measured."""

    samples: int = 2000
    """At most so many test frames, spread evenly over the trajectories of the test split."""
    seed: int = 0
    """Draws the random split of frames."""
    resamples: int = 1000
    """Of no effect, as intervals leave trajectories out; read, since older files say it."""


class Retrieval(NamedTuple):
    """What retrieval finds for N test frames under one split."""

    sample: Sample
    train: int
    """Frames that could be looked up."""
    images: Tensor
    """(N, 128, 128) uint8, the retrieved frames."""
    figures: dict[str, np.ndarray]
    """(N,) each: `ssim`, `psnr` dB, `position` mm, `rotation` degrees, `same_trajectory` 0 or 1,
    `seconds` between the two frames, NaN where they are of two trajectories."""
    scaled: bool = True
    """Whether the scale is known; else nothing is told in millimetres."""


class Leakage(NamedTuple):
    """The report's content, and the retrievals it speaks of, by split."""

    content: dict[str, Any]
    retrievals: dict[str, Retrieval]


def measure_leakage(
    store: FrameStore, config: LeakageConfig | None = None, progress: Progress | None = None
) -> Leakage:
    """Score nearest-pose retrieval under a split by frames and one by trajectories.

    Where the dataset holds out a session, under that split too, on frames of that session.
    """
    began = time.perf_counter()
    config = config or LeakageConfig()
    if not bool(store.parameters[:, 6:].isfinite().all()):
        raise RacinesError(f"the {store.manifest['source']} dataset has no poses to look up")
    train = store.split_indices("train")
    order = torch.randperm(len(store.images), generator=torch.Generator().manual_seed(config.seed))
    drawn = order[: len(train)].sort().values  # what a random split of frames would train on
    rows = store.split_indices("test")
    rows = rows[~torch.isin(rows, drawn)]
    if not len(train) or not len(rows):
        raise RacinesError("too few frames in train and test: rebuild with more trajectories")
    sample = spread_sample(store, rows, config.samples)
    retrievals = {
        "trajectory": _retrieve(store, sample, train, progress),
        "frame": _retrieve(store, sample, drawn, progress),
    }
    held = store.manifest.get("held_out_session")
    if held is not None:
        out = torch.tensor([session == held for session in store.sessions])[store.trajectory_index]
        of_session = spread_sample(store, out.nonzero()[:, 0], config.samples)
        others = (~out).nonzero()[:, 0]
        retrievals["session"] = _retrieve(store, of_session, others, progress)
    frame, trajectory = (retrievals[split].figures for split in ("frame", "trajectory"))
    gain = {name: frame[name] - trajectory[name] for name in UNITS}
    content = {
        "schema": SCHEMA,
        "dataset": dataset_card(store),
        "seed": config.seed,
        "sample": sample.digest,
        "splits": {name: _summary(each) for name, each in retrievals.items()},
        "gain": _means(gain, sample),  # what the frame split adds, frame by frame
        "leaks": leaks_json(find_leaks(store)),
        "settings": {
            "metres_per_radian": NearestPoseConfig().metres_per_radian,
            "ssim": metrics.SSIM_SETTINGS,
            "psnr": metrics.PSNR_SETTINGS,
        },
        "code": code_version(),
        "environment": environment(),
        "seconds": round(time.perf_counter() - began, 3),
    }
    return Leakage(content, retrievals)


def _retrieve(
    store: FrameStore, sample: Sample, train: Tensor, progress: Progress | None
) -> Retrieval:
    retrieval = NearestPose()
    retrieval.held["keys"] = retrieval.embed(store.conditions(train))
    parts = []
    for queries in sample.frames.parameters.split(CHUNK):
        parts.append(train[retrieval.nearest(queries)[0]])
        if progress is not None:
            progress(len(queries))
    found = store.take(torch.cat(parts))
    asked = parameters_to_pose(sample.frames.parameters.double())
    millimetres, degrees = pose_errors(asked, found.parameters)
    same = store.trajectory_index[sample.frames.index] == store.trajectory_index[found.index]
    apart = (store.timestamps[sample.frames.index] - store.timestamps[found.index]).abs()
    figures = {
        "ssim": metrics.ssim(found.images, sample.frames.images),
        "psnr": metrics.psnr(found.images, sample.frames.images),
        "position": millimetres,
        "rotation": degrees,
        "same_trajectory": same,
        "seconds": torch.where(same, apart, torch.nan),
    }
    values = {name: each.double().numpy() for name, each in figures.items()}
    return Retrieval(sample, len(train), found.images, values, scale_known(store.manifest))


def _summary(retrieval: Retrieval) -> dict[str, Any]:
    figures = retrieval.figures

    def median(name: str) -> float | None:
        present = figures[name][np.isfinite(figures[name])]
        return float(np.median(present)) if len(present) else None

    return {
        "train": retrieval.train,
        **_means(figures, retrieval.sample),
        "position_mm": median("position") if retrieval.scaled else None,
        "rotation_deg": median("rotation"),
        "same_trajectory": float(figures["same_trajectory"].mean()),
        "seconds": median("seconds"),
    }


def _means(figures: dict[str, np.ndarray], sample: Sample) -> dict[str, dict[str, Any]]:
    """Return the means of SSIM and PSNR, or of their differences, with intervals."""
    return {
        name: mean_interval(figures[name], sample.trajectory).to_json(unit)
        for name, unit in UNITS.items()
    }
