"""The ejection fraction of one plane, from outlines: the method of disks, and how two sides agree.

The volume of a ventricle is taken for that of a stack of twenty round disks along its long axis
(Schiller et al., JASE 1989; Lang et al., JASE 2015, single plane). The long axis runs from the
middle of the mitral plane, where ventricle and atrium touch, to the point farthest from it.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from racines_models.statistics import Replicates, interval, set_replicates_all
from racines_models.studies.sim_to_real.sectors import parts

DISKS = 20
LV, LA = 1, 3
"""CAMUS's numbers."""
FEWEST = 40
"""Pixels below which no ventricle is seen."""
TOUCH = 3
"""Pixels of a mitral plane; with fewer, the end far from the probe is taken for it."""


class Ventricle(NamedTuple):
    """A left ventricle in one plane; NaN where none is seen."""

    volume: float
    """By the method of disks, mL."""
    length: float
    """Of the long axis, mm."""


def disk_volume(mask: np.ndarray, mm: np.ndarray) -> float:
    """Return the volume of `measure_ventricle` alone."""
    return measure_ventricle(mask, mm).volume


def measure_ventricle(mask: np.ndarray, mm: np.ndarray) -> Ventricle:
    """Return volume, mL, and length, mm, of the left ventricle; NaN where none is seen.

    Args:
        mask: (H, W) of CAMUS's numbers; of the ventricle, the largest connected part counts.
        mm: (2,) millimetres a row and a column.
    """
    number, sizes = parts(mask == LV)
    if not len(sizes) or sizes.max() < FEWEST:
        return Ventricle(float("nan"), float("nan"))
    ventricle = number == 1 + int(np.argmax(sizes))
    points = np.argwhere(ventricle) * mm
    base = _mitral_plane(ventricle, mask == LA, mm)
    away = points - base
    apex = away[np.argmax(np.square(away).sum(1))]
    length = float(np.linalg.norm(apex))
    along = away @ (apex / length)
    height = length / DISKS
    # What lies beyond the plane on a slanted edge belongs to the first disk.
    disk = np.clip(along / height, 0, DISKS - 1).astype(int)
    width = np.bincount(disk, minlength=DISKS) * float(mm.prod()) / height
    volume = float(np.pi / 4.0 * np.square(width).sum() * height / 1e3)
    return Ventricle(volume, length)


def _mitral_plane(ventricle: np.ndarray, atrium: np.ndarray, mm: np.ndarray) -> np.ndarray:
    """Return the middle of the mitral plane, (2,) millimetres from the image's first pixel."""
    border = np.argwhere(ventricle & ndimage.binary_dilation(atrium, iterations=2)) * mm
    if len(border) >= TOUCH:
        return border.mean(0)
    points = np.argwhere(ventricle) * mm
    middle = points.mean(0)
    axis = np.linalg.eigh(np.cov((points - middle).T))[1][:, -1]
    axis = axis if axis[0] > 0 else -axis  # depth grows with the row
    along = (points - middle) @ axis
    last = along > np.quantile(along, 0.95)
    return points[last].mean(0) + axis * (along.max() - along[last].mean())


def ejection_fractions(
    masks: np.ndarray, patient: np.ndarray, phase: np.ndarray, mm: np.ndarray
) -> dict[str, tuple[float, float, float]]:
    """Return by patient the end-diastolic and end-systolic volume, mL, and ejection fraction, %.

    Patients without both phases are left out; what is not seen is NaN.

    Args:
        masks: (M, H, W) of CAMUS's numbers.
        patient: (M,) ids.
        phase: (M,) `ED` or `ES`.
        mm: (M, 2) millimetres a row and a column.
    """
    volumes: dict[tuple[str, str], float] = {}
    for mask, who, when, size in zip(masks, patient, phase, mm, strict=True):
        volumes[str(who), str(when)] = disk_volume(mask, size)
    found = {}
    for who in dict.fromkeys(map(str, patient)):
        if (who, "ED") in volumes and (who, "ES") in volumes:
            full, empty = volumes[who, "ED"], volumes[who, "ES"]
            found[who] = full, empty, 100.0 * (full - empty) / full
    return found


def agreement(
    found: np.ndarray, truth: np.ndarray, unit: str, most: float = np.inf,
    units: np.ndarray | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return bias, limits of agreement (Bland and Altman, 1986) and correlation, with intervals.

    Args:
        found: (P,) by the judge, or (R, P) by as many trainings; NaN where it saw nothing: left
            out, and counted, over all trainings.
        truth: (P,) that it is held against, as the cardiologists' outlines.
        unit: of both.
        most: what `found` can be at most, and 0 at least; what no heart does is left out, and
            counted: one ventricle a tenth of its size would be the mean of all.
        units: (P,) what was drawn independently; each is one by default.
    """
    found = np.atleast_2d(found)
    units = np.arange(len(truth)) if units is None else units
    seen = np.isfinite(found) & np.isfinite(truth)
    possible = seen & (found >= 0.0) & (found <= most)
    counts = {"patients": int(possible.sum()), "not_seen": int((~seen).sum())}
    counts["impossible"] = int((seen & ~possible).sum())
    if possible.sum(1).min() < 3:
        return counts
    # A patient whom one training did not see is left out of that one alone.
    held = possible.any(0)
    found, truth, possible, units = found[:, held], truth[held], possible[:, held], units[held]

    def statistics(row: int) -> Callable[[np.ndarray], Mapping[str, float]]:
        def of(keep: np.ndarray) -> Mapping[str, float]:
            kept = keep & possible[row]
            return _agreement(found[row, kept], truth[kept])

        return of

    replicates = set_replicates_all([statistics(row) for row in range(len(found))], units)
    return counts | {name: _told(name, each, unit) for name, each in replicates.items()}


def _agreement(found: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    apart = found - truth
    bias, spread = float(apart.mean()), 1.96 * float(apart.std(ddof=1))
    varied = min(found.std(), truth.std()) > 0  # what is the same for all tells nothing
    return {
        "bias": bias,
        "lower_limit": bias - spread,
        "upper_limit": bias + spread,
        "absolute": float(np.abs(apart).mean()),
        "correlation": float(np.corrcoef(found, truth)[0, 1]) if varied else 0.0,
    }


def _told(name: str, replicates: Replicates, unit: str) -> dict[str, Any]:
    if name == "correlation":
        return interval(replicates, -1.0, 1.0).to_json()
    return interval(replicates, 0.0 if name == "absolute" else -np.inf).to_json(unit)
