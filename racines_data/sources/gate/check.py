"""The gate itself: one trajectory, and the trajectories of a dataset against one another."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from racines_data.errors import RacinesError
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.sources.gate.bounds import Bounds
from racines_data.sources.gate.motion import motion_faults
from racines_data.sources.gate.numbers import number_faults
from racines_data.sources.gate.pixels import pixel_faults, shape_fault
from racines_data.sources.images import Fault
from racines_data.views import LABELS


def check_trajectory(
    trajectory: Trajectory,
    unit: Unit,
    labels: Sequence[str] = LABELS,
    poses: bool = True,
    bounds: Bounds | None = None,
    source: str = "",
) -> None:
    """Check what a source with these view labels has made of a unit.

    A source without poses (single images, labelled) has neither poses nor times: all NaN.

    Args:
        trajectory: What the source made.
        unit: What it was asked for.
        labels: Names of the views, `Random` last.
        poses: Whether the source has poses and times at all.
        bounds: What is plausible of it; the usual, if left out.
        source: Its name, for the message.

    Raises:
        RacinesError: wrong identity, image shape or type, a pose or time that is not finite, a
            label or grade out of range, or what is likely a mistake of units, frames, clock or
            images: with the source, the trajectory, the field, what was found and the remedy.
    """
    bounds = bounds or Bounds()
    where = f"source {source}, trajectory {unit.id}" if source else f"trajectory {unit.id}"
    _check_names(trajectory, unit, labels, where)
    if fault := shape_fault(trajectory.images):
        raise RacinesError(f"{where}: {fault}")
    if not poses and not (
        np.isnan(trajectory.parameters).all() and np.isnan(trajectory.timestamps).all()
    ):
        raise RacinesError(f"{where}: has poses or times, but its source says that it has none")
    for opinion, fault in _faults(trajectory, poses, bounds):
        if opinion not in bounds.allow:
            remedy = f". If it is right as it is: --allow {opinion}" if opinion else ""
            raise RacinesError(f"{where}: {fault}{remedy}")
    _check_labels(trajectory, labels, where)


def _faults(trajectory: Trajectory, poses: bool, bounds: Bounds) -> Iterator[tuple[str, Fault]]:
    """Yield what is wrong, what is certain first, each with the opinion's name, if it is one."""
    if poses:
        wrong = None
        for wrong in number_faults(trajectory, bounds):
            yield "", wrong
        if wrong is None:
            yield from motion_faults(trajectory, bounds)
    yield from pixel_faults(trajectory, poses)


def _check_names(trajectory: Trajectory, unit: Unit, labels: Sequence[str], where: str) -> None:
    made = (trajectory.id, trajectory.session, trajectory.target_view)
    if made != (unit.id, unit.session, unit.target_view):
        raise RacinesError(f"{where}: the source made {made} of it; names must stay the unit's")
    if trajectory.target_view not in labels:
        raise RacinesError(
            f"{where}: unknown target view {trajectory.target_view!r}; one of {', '.join(labels)}"
        )


def _check_labels(trajectory: Trajectory, labels: Sequence[str], where: str) -> None:
    grades = trajectory.grades[~np.isnan(trajectory.grades)]
    if ((grades < 0) | (grades > 10)).any():
        raise RacinesError(f"{where}: a grade lies outside 0-10")
    if ((trajectory.views < -1) | (trajectory.views >= len(labels))).any():
        raise RacinesError(f"{where}: a view label lies outside -1 to {len(labels) - 1}")


@dataclass(frozen=True)
class Scale:
    """The sizes of one trajectory's numbers; NaN where there are none."""

    trajectory: str
    position: float
    """Median distance from the origin, m."""
    force: float
    """Upper decile of the force, N."""
    step: float
    """Median time between frames, s."""


def scale_of(name: str, wrench: np.ndarray, positions: np.ndarray, times: np.ndarray) -> Scale:
    """Return the sizes of a trajectory of (T, 6) forces, (T, 3) positions and (T,) times."""
    force = np.linalg.norm(wrench[:, :3].astype(float), axis=-1)
    force = force[~np.isnan(force)]
    return Scale(
        name,
        float(np.median(np.linalg.norm(positions.astype(float), axis=-1))),
        float(np.quantile(force, 0.9)) if len(force) else np.nan,
        float(np.median(np.diff(times))) if len(times) > 1 else np.nan,
    )


_APART = {"position": (30.0, 0.02), "force": (40.0, 1.0), "step": (100.0, 0.0)}
"""How many times the usual one a trajectory's size may be, and the usual from which on it tells."""


def check_scales(scales: Sequence[Scale], source: str, allow: Sequence[str] = ()) -> None:
    """Refuse trajectories of one source whose numbers are in different units.

    Each may be plausible by itself: what tells is a size that is tens of times that of most others.

    Raises:
        RacinesError: which trajectory, which numbers, how many times those of the others.
    """
    if "units-mixed" in allow or len(scales) < 2:
        return
    for field, (factor, least) in _APART.items():
        sizes = np.array([getattr(scale, field) for scale in scales])
        known = np.flatnonzero(sizes > 0)
        if len(known) < 2:
            continue
        usual = float(np.median(sizes[known]))
        ratio = sizes[known] / usual
        odd = known[(ratio > factor) | (ratio < 1 / factor)]
        if field == "force":  # a sweep without contact has next to none: only more is odd
            odd = known[ratio > factor]
        if len(odd) and max(usual, float(sizes[odd].max())) > least:
            raise RacinesError(
                f"source {source}, trajectory {scales[odd[0]].trajectory}: {field}: mixed units: "
                f"{sizes[odd[0]]:.3g} where {usual:.3g} is usual in the {len(known)} trajectories, "
                f"{len(odd)} such; give one unit throughout, or import them apart. "
                "If it is right as it is: --allow units-mixed"
            )
