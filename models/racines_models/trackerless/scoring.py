"""Scores of estimated motion on held-out sweeps: each number with n, an interval, provenance.

    sweep ──> images ──> estimator ──> motion ─┐
          └─> poses ───> true motion ──────────┴─> errors of the sweep ──> mean over sweeps

Intervals resample patients (of recordings, the recordings; of the phantom, the sweeps), and
trainings where a method is trained. What cannot be told in millimetres is withheld, and why.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_models.provenance import code_version, environment
from racines_models.statistics import Evidence
from racines_models.trackerless import landmarks as places
from racines_models.trackerless.floors import NoMotion
from racines_models.trackerless.metrics import ENDS, METRICS, PIXELS, PROBE, TURNS, errors
from racines_models.trackerless.motion import Motion, to_vectors
from racines_models.trackerless.planes import LARGEST, Plane, sector_plane, stated_plane
from racines_models.trackerless.sweeps import Shown, Sweep, SweepSet, digest_of

SCHEMA = "racines.motion-scores/1"
SHARES = ("score",)
"""TUS-REC's final score: 1 - error / that of no motion, a mean of the four errors."""
AXES = ("shift_x", "shift_y", "shift_z", "turn_x", "turn_y", "turn_z")
"""Of the probe: x to the right of the image, y out of its plane, z along the middle beam."""
SHIFTS = 3
"""How many of them, the first ones, are shifts."""
NOTES = [
    "Errors are means over sweeps of means over pixels, or landmarks, of all frames but the first.",
    "Landmarks are corners found in the images, where TUS-REC has anatomical ones.",
    "Intervals are over units and trainings; those of one training say nothing of another.",
]


@dataclass(frozen=True)
class MotionScoresConfig:
    """On which sweeps motion is scored, and where their pixels lie."""

    split: str = "test"
    """`train`, `validation`, `test`, or `all` of recordings that nothing was learned from."""
    landmarks: int = places.COUNT
    """Of each sweep."""
    pixel_mm: float = 0.0
    """Side of a pixel of the 128 × 128 image where the data do not say it; 0: not known."""
    plane: tuple[float, ...] = ()
    """Where pixels lie about the tracked marker: the first pixel's place and the steps to the next
    column and the next row, nine numbers, mm. Empty: in the probe's own x and z, with the probe in
    the middle of the first row."""

    def __post_init__(self) -> None:
        """Refuse what is no size, number or plane."""
        if self.landmarks < 1:
            raise RacinesError(f"motion_scores.landmarks {self.landmarks}: give one or more")
        if not 0.0 <= self.pixel_mm <= LARGEST:
            told = f"give mm, at most {LARGEST:g}"
            raise RacinesError(f"motion_scores.pixel_mm {self.pixel_mm:g}: {told}")
        if self.pixel_mm and self.plane:
            raise RacinesError("motion_scores: give pixel_mm or plane, not both")
        self.stated()

    def stated(self) -> Plane | None:
        """Return the plane that is stated; None where none is."""
        if self.plane:
            return stated_plane(self.plane, "motion_scores.plane")
        return sector_plane(self.pixel_mm) if self.pixel_mm else None


@dataclass(frozen=True)
class MotionScores:
    """The scores file's content, and what its figures follow from."""

    content: dict[str, Any]
    evidence: Evidence


def asked(sweeps: SweepSet, config: MotionScoresConfig) -> list[Sweep]:
    """Return the sweeps that are scored, each with its plane, as the data or the config say it.

    Raises:
        RacinesError: no such sweeps; or a plane is stated of data that know theirs, or that have
            no metres.
    """
    found, stated = sweeps.sweeps(config.split), config.stated()
    if stated is None:
        return found
    if not sweeps.metric:
        raise RacinesError(
            "motion_scores: positions of these data have no metres, so pixels in mm do not fit "
            "them: leave out pixel_mm and plane, or import them with their scale"
        )
    if any(each.plane is not None for each in found):
        raise RacinesError(
            "motion_scores: these data say where their pixels lie: leave out pixel_mm and plane"
        )
    return [replace(each, plane=stated) for each in found]


def estimate_all(
    estimators: Sequence[Any],
    sweeps: SweepSet,
    found: Sequence[Sweep],
    progress: Callable[[int], None] | None = None,
) -> list[dict[str, Motion]]:
    """Return the motions of sweeps that each training of an estimator finds, by the sweeps' ids.

    Raises:
        RacinesError: not one transform a frame.
    """
    told = []
    for one in estimators:
        motions = {}
        for sweep in found:
            shown = sweeps.shown(sweep, told_first=bool(one.told_first))
            motions[sweep.id] = _checked(one.estimate(shown), shown, one.name)
            if progress is not None:
                progress(len(sweep))
        told.append(motions)
    return told


def _checked(motion: Motion, shown: Shown, name: str) -> Motion:
    shapes = [tuple(each.shape) for each in motion]
    wanted = (len(shown.images), 4, 4)
    if shapes != [wanted, wanted]:
        raise RacinesError(f"{name}: transforms of shapes {shapes}: give {wanted} twice")
    if not all(bool(each.isfinite().all()) for each in motion):
        raise RacinesError(f"{name}: transforms are not finite: nothing can be scored")
    return motion


def score_motion(
    name: str,
    motions: Sequence[dict[str, Motion]],
    sweeps: SweepSet,
    config: MotionScoresConfig,
    about: dict[str, Any] | None = None,
    device: str = "cpu",
) -> MotionScores:
    """Score motions of a split's sweeps, of one or several trainings.

    Args:
        name: of the method.
        motions: of each training, by the sweeps' ids.
        sweeps: of the dataset.
        config: which sweeps, and where their pixels lie.
        about: what else the record says of the method: `trained`, `told_first`, `weights`, `seeds`.
        device: where the motions were estimated.

    Raises:
        RacinesError: as `asked`.
    """
    began = time.perf_counter()
    found = asked(sweeps, config)
    values = _errors(motions, sweeps, found, config.landmarks)
    items = np.array([each.number for each in found])
    units = np.array([each.unit for each in found])
    evidence, metrics = Evidence(), {}
    for metric in (*METRICS, *SHARES):
        table = values[metric]
        if np.isfinite(table).any(1).all():
            ends = ENDS.get(metric, (-np.inf, 1.0))
            figures = evidence.add(metric, "mean", table[:, None], items, units, *ends)
            metrics[metric] = figures.interval().to_json(_unit(metric))
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "motion": name,
        "dataset": sweeps.card | {"split": config.split, "sweeps": digest_of(found)},
        "counts": {
            "sweeps": len(found),
            "frames": sum(map(len, found)),
            "left_out": sweeps.left_out[config.split],
        },
        "sweeps": {str(each.number): each.id for each in found},
        "runs": len(motions),
        "metrics": metrics,
        "explained": _explained(motions, found, sweeps.metric),
        "withheld": _withheld(sweeps, found),
        "settings": described(config),
        "trained": False,
        "told_first": False,
        "weights": None,
    }
    content |= about or {}
    content |= {"code": code_version(), "environment": environment(device)}
    content |= {"seconds": round(time.perf_counter() - began, 3), "notes": NOTES}
    return MotionScores(content, evidence)


def described(config: MotionScoresConfig) -> dict[str, Any]:
    """Return the settings on which the numbers rest, beside the split."""
    return {
        "landmarks": config.landmarks,
        "pixel_mm": config.pixel_mm or None,
        "plane": list(config.plane) or None,
    }


def _unit(metric: str) -> str | None:
    if metric in SHARES:
        return None
    return "deg" if metric in TURNS else "mm"


def _errors(
    motions: Sequence[dict[str, Motion]], sweeps: SweepSet, found: Sequence[Sweep], count: int
) -> dict[str, np.ndarray]:
    """Return (R, N) of each metric, NaN where it cannot be told."""
    names = (*METRICS, *SHARES)
    values = {name: np.full((len(motions), len(found)), np.nan) for name in names}
    still = NoMotion()
    for place, sweep in enumerate(found):
        shown = sweeps.shown(sweep)
        marks = places.landmarks(shown.images, count)
        scale = sweep.motion, sweep.plane, marks, sweeps.metric
        worst = errors(still.estimate(shown), *scale)
        for training, each in enumerate(motions):
            told = errors(each[sweep.id], *scale)
            shares = [1.0 - told[key] / worst[key] for key in PIXELS if worst.get(key)]
            if len(shares) == len(PIXELS):
                told["score"] = float(np.mean(shares))
            for name, value in told.items():
                values[name][training, place] = value
    return values


def _explained(
    motions: Sequence[dict[str, Motion]], found: Sequence[Sweep], metric: bool
) -> dict[str, float | None]:
    """Return of each of the six numbers of a step the share of its power that is estimated.

    It is 1 - sum of squared errors / sum of squares: 0 for a probe that rests, 1 for the truth.
    Shifts x and z and turns about y keep to the image plane; the others leave it. Of positions
    without metres no shift is told, since estimates are in metres.
    """
    true = torch.cat([to_vectors(each.motion.to_previous[1:]) for each in found])
    power = true.square().sum(0)
    missed = torch.zeros_like(power)
    for each in motions:
        told = torch.cat([to_vectors(each[sweep.id].to_previous[1:]) for sweep in found])
        missed += (told.double() - true).square().sum(0) / len(motions)
    if not metric:
        power[:SHIFTS] = 0.0
    share = zip(AXES, (1.0 - missed / power).tolist(), power.tolist(), strict=True)
    return {name: value if whole > 0 else None for name, value, whole in share}


def _withheld(sweeps: SweepSet, found: Sequence[Sweep]) -> dict[str, str]:
    """Return why some metrics are not told, by their names."""
    if not sweeps.metric:
        reason = "positions of these data have no metres"
        return dict.fromkeys((*PIXELS, *PROBE, *SHARES), reason)
    if any(each.plane is None for each in found):
        reason = "these data do not say where pixels lie: set pixel_mm or plane"
        return dict.fromkeys((*PIXELS, *SHARES), reason)
    return {}
