"""What carries over to any imported set: recognised views, likeness, and motion that is read.

    frames of the set ──> grader of simulated patients ──> what they are called
                      ──> Inception ──> KID to frames of simulated patients
                      ──> pose regressor ──> motion between frames, beside the recorded one

All judges saw simulated patients alone, and nothing is chosen here. A regressor of patients reads a
pose about the heart, recordings know it in their tracker's frame: what both know is the motion from
one frame to another. Frames are paired within a sweep. A turn about the apex is a trajectory of one
pose, and all turns of a recording share one frame: there, frames of one phase are paired.
"""

import time
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose
from racines_data.manifest import is_turned, scale_known
from racines_data.store.frames import FrameStore
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.protocol import Judge
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import evenly
from racines_models.scores import metrics
from racines_models.scores.features import Extractor
from racines_models.statistics import rate_interval
from racines_models.studies.realism.patient_frames import of_patients
from racines_models.studies.realism.report import RealismConfig

SCHEMA = "racines.sim-to-real-imported/1"
FRAMES = 512
"""At most so many frames of the set, at even distances."""
SIMULATED = 125
"""Frames of as many simulated patients, for KID."""
FEWEST = 20
"""Frames or pairs below which a figure is left out."""
MOVED = 5.0
"""Degrees by which a frame has turned from the one that it is held beside, at least."""


class Imported(NamedTuple):
    """The report, and what it rests on."""

    content: dict[str, Any]
    images: Tensor
    """(N, 128, 128) uint8 that were looked at."""
    called: list[str]
    """(N,) what each is called; empty without a grader."""


def measure_imported(
    store: FrameStore,
    grader: Judge | None = None,
    pose: PoseRegressor | None = None,
    extractor: Extractor | None = None,
    seed: int = 0,
) -> Imported:
    """Ask judges of simulated patients about the frames of a dataset.

    Args:
        store: the imported set.
        grader: names views.
        pose: reads poses.
        extractor: whose features KID compares.
        seed: draws the simulated frames.

    Raises:
        RacinesError: no judge at all.
    """
    if grader is None and pose is None and extractor is None:
        raise RacinesError("no judge: give --grader FOLDER, or leave --no-grader out")
    began = time.perf_counter()
    rows = evenly(len(store.images), FRAMES)
    images, units = store.images[rows], store.trajectory_index[rows].numpy()
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "dataset": dataset_card(store),
        "frames": len(rows),
        "trajectories": len(np.unique(units)),
    }
    called: list[str] = []
    if grader is not None:
        content["grader"], label = grader.settings, _labels(grader, images)
        called = [grader.labels[each] for each in label]
        content["recognised"] = _recognised(store, grader, rows, label, units)
    if extractor is not None:
        content["kid"] = _likeness(images, extractor, seed)
    if pose is not None:
        content["pose"] = pose.settings
        content["motion"] = _motion(store, pose, rows, images)
    content |= {"code": code_version(), "environment": environment()}
    content["seconds"] = round(time.perf_counter() - began, 3)
    return Imported(content, images, called)


def _labels(grader: Judge, images: Tensor) -> np.ndarray:
    parts = [grader.probabilities_and_grade(part)[0].argmax(1).cpu() for part in images.split(256)]
    return torch.cat(parts).numpy()


def _recognised(
    store: FrameStore, grader: Judge, rows: Tensor, label: np.ndarray, units: np.ndarray
) -> dict[str, Any]:
    """Return what frames are called, and of each view that the set labels the share called so."""
    told: dict[str, Any] = {
        "called": {name: int((label == k).sum()) for k, name in enumerate(grader.labels)}
    }
    own = store.views[rows].numpy()
    for view, name in enumerate(store.labels):
        inside = own == view
        if name in grader.labels and inside.sum() >= FEWEST:
            hits = label[inside] == grader.labels.index(name)
            told.setdefault("views", {})[name] = rate_interval(hits, units[inside]).to_json()
    return told


def _likeness(images: Tensor, extractor: Extractor, seed: int) -> dict[str, Any]:
    """Return KID between frames of the set and A4C frames of simulated patients, equal n."""
    count = min(SIMULATED, len(images))
    if count < FEWEST:
        return {"value": None, "n": count}
    config = RealismConfig(frames=count, seed=seed)
    simulated = of_patients(config, beating=True)
    some = images[evenly(len(images), len(simulated.images))]
    value = metrics.kid(extractor(simulated.images), extractor(some))
    told = {"value": value, "n": len(some), "view": config.view, "simulated": simulated.told}
    return told | {"extractor": extractor.settings}


def _motion(
    store: FrameStore, regressor: PoseRegressor, rows: Tensor, images: Tensor
) -> dict[str, Any]:
    """Return how far the motion that is read agrees with the recorded one, in angle and shift."""
    recorded = parameters_to_pose(store.parameters[rows].double())
    known = torch.isfinite(recorded.position).all(1) & torch.isfinite(recorded.rotation).all((1, 2))
    first, second = _pairs(recorded, known, _comparable(store, rows))
    if len(first) < FEWEST:
        return {"pairs": len(first), "told": "too few pairs of frames with poses that turned"}
    read = regressor.predict(images)
    told: dict[str, Any] = {"pairs": len(first), "moved_at_least_deg": MOVED}
    told["paired"] = "turns, at one phase" if is_turned(store.manifest) else "within a trajectory"
    angles = [geodesic(p.rotation[first].double(), p.rotation[second].double()).cpu().numpy()
              for p in (recorded, read)]  # fmt: skip
    told["angle_deg"] = _agreement(*(np.degrees(each) for each in angles))
    if scale_known(store.manifest):
        shifts = [(p.position[first].double() - p.position[second].double()).norm(dim=1)
                  for p in (recorded, read)]  # fmt: skip
        told["shift_mm"] = _agreement(*(1e3 * each.cpu().numpy() for each in shifts))
    return told


def _comparable(store: FrameStore, rows: Tensor) -> Tensor:
    """Return (N,) numbers of groups: frames of one have poses in one frame, and one phase."""
    if not is_turned(store.manifest) or store.phases is None:
        return store.trajectory_index[rows]
    names = sorted(set(store.sessions))
    sessions = torch.tensor([names.index(each) for each in store.sessions])
    phases = torch.nan_to_num(store.phases[rows, 0])  # of still frames there is none
    keys = torch.stack([sessions[store.trajectory_index[rows]].double(), phases.round(decimals=6)])
    return keys.unique(dim=1, return_inverse=True)[1]


def _pairs(pose: Pose, known: Tensor, group: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rows of pairs: each frame, and the first after it in its group that has turned."""
    first, second = [], []
    for row in known.nonzero()[:, 0].tolist():
        later = torch.arange(row + 1, len(known))
        later = later[(group[later] == group[row]) & known[later]]
        if len(later):
            turned = geodesic(pose.rotation[row].expand(len(later), 3, 3), pose.rotation[later])
            far = (torch.rad2deg(turned) >= MOVED).nonzero()
            if len(far):
                first.append(row)
                second.append(int(later[far[0, 0]]))
    return torch.tensor(first, dtype=torch.int64), torch.tensor(second, dtype=torch.int64)


def _agreement(true: np.ndarray, read: np.ndarray) -> dict[str, Any]:
    """Return medians of what is true and read, the median error, and the correlation."""
    spread = min(float(true.std()), float(read.std()))
    return {
        "true_median": float(np.median(true)),
        "read_median": float(np.median(read)),
        "error_median": float(np.median(np.abs(read - true))),
        "correlation": float(np.corrcoef(true, read)[0, 1]) if spread > 1e-9 else None,
    }
