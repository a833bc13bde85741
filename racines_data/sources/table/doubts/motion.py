"""What rotations and positions say together, and what stands still.

Of another reading (the quaternion's other order, the transposed matrix, the inverse pose) it is
asked whether it fits far better than the one given:

- a marker on a probe that is turned about a point moves as p = c + R l, so that a wrong R leaves
  its motion unexplained;
- seen from a tracker two metres away, trembling hands turn the inverse through metres;
- in a robot's frame the beam looks down.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from racines_data.sources.table.doubts.base import Doubt
from racines_data.sources.table.doubts.names import tells_order
from racines_data.sources.table.mapping import Mapping, Quaternion, RotationMatrix
from racines_data.sources.table.poses import calibrate, inverse, turned
from racines_data.sources.table.rows import numbers
from racines_data.sources.table.sweeps import Draft

_FEWEST = 12
_TURN = np.radians(5)
"""A probe that turns by less tells nothing of its lever."""
_BETTER, _LEFT, _UNEXPLAINED = 4.0, 0.1, 0.4
"""How many times less another reading has to leave open; at most so much; and the given at least.
Shares of the energy of the motion."""
_LONGER = 4.0
"""How many times longer the path of the pose given is than that of its inverse, if inverted."""
_DOWN, _MOSTLY, _MORE = 0.3, 0.9, 0.3
"""The beam's part downwards, the share of the rows, and how much more than as given."""


def motion_doubts(mapping: Mapping, drafts: Sequence[Draft]) -> Iterator[Doubt]:
    """Yield what the motion contradicts; poses must be rigid, but for rows that are not numbers."""
    poses = [draft.poses[np.isfinite(draft.poses).all((1, 2))] for draft in drafts]
    poses = [each for each in poses if len(each) >= 3]
    if sum(map(len, poses)) < _FEWEST:
        return
    yield from _frozen(poses)
    yield from _inverted(mapping, poses)
    yield from _lever(mapping, drafts)
    if mapping.frame == "robot":
        yield from _down(mapping, drafts, poses)


def _frozen(poses: Sequence[np.ndarray]) -> Iterator[Doubt]:
    same = np.concatenate([(each[1:] == each[:-1]).all((1, 2)) for each in poses])
    if same.all():
        detail = f"all {len(same) + len(poses)} rows have one pose, to the last bit"
        remedy = "name the columns that change"
        yield Doubt("frozen poses", "poses.position.columns", detail, remedy, certain=False)
    elif same.mean() > 0.5:
        detail = f"{same.mean():.0%} of the rows repeat the pose before: a slower tracker"
        remedy = "give its rows once, and images.clock for the images"
        yield Doubt("frozen poses", "poses", detail, remedy, certain=False)


def _path(poses: Sequence[np.ndarray]) -> float:
    return float(
        sum(np.linalg.norm(np.diff(each[:, :3, 3], axis=0), axis=1).sum() for each in poses)
    )


def _inverted(mapping: Mapping, poses: Sequence[np.ndarray]) -> Iterator[Doubt]:
    given = [inverse(each) if mapping.poses.invert else each for each in poses]
    there, back = _path(given), _path([inverse(each) for each in given])
    if there > _LONGER * back and there > 0.02:
        detail = (
            f"the probe moves {1e3 * there:.0f} mm as given, and {1e3 * back:.0f} mm if the pose "
            "is inverted"
        )
        remedy = f"set invert: {str(not mapping.poses.invert).lower()}"
        yield Doubt("inverted", "poses.invert", detail, remedy, certain=False)


def _readings(mapping: Mapping, draft: Draft) -> dict[tuple[str, str, str], np.ndarray]:
    """Return (T, 4, 4) poses of a draft in other readings, by name, field and remedy.

    None where the columns' names say which reading is right.
    """
    rotation, found = mapping.poses.rotation, {}
    if tells_order(rotation):
        return found
    if isinstance(rotation, Quaternion):
        other = "xyzw" if rotation.order == "wxyz" else "wxyz"
        values = numbers(draft.table, rotation.columns, "poses.rotation.columns", draft.path)
        made = draft.poses.copy()
        made[:, :3, :3] = turned(values, rotation.model_copy(update={"order": other}))
        name = "w first" if other == "wxyz" else "w last"
        found[name, "poses.rotation.order", f"set order: {other}"] = made
    if isinstance(rotation, Quaternion | RotationMatrix):
        made = draft.poses.copy()
        made[:, :3, :3] = draft.poses[:, :3, :3].transpose(0, 2, 1)
        remedy = "give the columns of R as the probe's axes"
        if isinstance(rotation, RotationMatrix):
            other = "columns" if rotation.layout == "rows" else "rows"
            remedy = f"set layout: {other}"
        found["transposed", "poses.rotation", remedy] = made
    return found


def _lever(mapping: Mapping, drafts: Sequence[Draft]) -> Iterator[Doubt]:
    given = _unexplained([draft.poses for draft in drafts])
    if given < _UNEXPLAINED:
        return
    for name, field, remedy in _readings(mapping, drafts[0]):
        other = [_readings(mapping, draft)[name, field, remedy] for draft in drafts]
        left = _unexplained(other)
        if left < _LEFT and given > _BETTER * left:
            detail = (
                f"turning about a point explains {1 - left:.0%} of the motion if read so, "
                f"{1 - given:.0%} as given"
            )
            yield Doubt(name, field, detail, remedy, certain=False)
            return


def _unexplained(sweeps: Sequence[np.ndarray]) -> float:
    """Return the share of the positions' variance that p = c + R l leaves, one l, a c a sweep.

    NaN where the probe turns too little to tell. Source: pivot calibration, e.g. Yaniv, Which pivot
    calibration?, 2015.
    """
    matrices, places = [], []
    for poses in sweeps:
        poses = poses[np.isfinite(poses).all((1, 2))]
        if len(poses) < 3:
            continue
        turns = poses[:, :3, :3]
        cosine = (np.einsum("tij,ij->t", turns, turns[0]) - 1) / 2
        if np.arccos(np.clip(cosine, -1, 1)).max() < _TURN:
            continue
        matrices.append((turns - turns.mean(0)).reshape(-1, 3))
        places.append((poses[:, :3, 3] - poses[:, :3, 3].mean(0)).reshape(-1))
    if not places or (energy := float((np.concatenate(places) ** 2).sum())) == 0:
        return float("nan")
    moved, turns = np.concatenate(places), np.concatenate(matrices)
    lever = np.linalg.lstsq(turns, moved, rcond=1e-9)[0]
    return float(((turns @ lever - moved) ** 2).sum()) / energy


def _down(
    mapping: Mapping, drafts: Sequence[Draft], poses: Sequence[np.ndarray]
) -> Iterator[Doubt]:
    """Yield the reading in which the beam looks down, where as given it often does not."""

    def share(found: Sequence[np.ndarray]) -> float:
        held = [calibrate(each, mapping.calibration, mapping.poses.invert) for each in found]
        return float((np.concatenate(held)[:, 2, 2] < -_DOWN).mean())

    given = share(poses)
    for name, field, remedy in _readings(mapping, drafts[0]):
        other = [_readings(mapping, draft)[name, field, remedy] for draft in drafts]
        other = [each[np.isfinite(each).all((1, 2))] for each in other]
        if (down := share(other)) >= _MOSTLY and down - given > _MORE:
            detail = (
                f"the beam (the probe's z) looks down in {given:.0%} of the rows as given, in "
                f"{down:.0%} if read so"
            )
            yield Doubt(name, field, detail, remedy, certain=False)
            return
