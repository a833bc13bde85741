"""Checks of the rows together: counts, content digest, splits, clock."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from racines_data.digest import content_digest
from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM, config_digest
from racines_data.schema import SPLITS
from racines_data.validate.survey import Survey

RATE_TOLERANCE = 0.01
"""Largest departure of a time step from the median one, as a share."""


def check_counts(survey: Survey, manifest: dict[str, Any]) -> str:
    """Check the numbers of frames and trajectories of each split.

    Raises:
        RacinesError: they are not those recorded.
    """
    many = survey.config == MULTI_PHANTOM
    recorded = (manifest[MULTI_PHANTOM] if many else manifest["counts"])["splits"]
    for split in SPLITS:
        sweeps = [sweep for sweep in survey.sweeps if sweep.split == split]
        found = {"trajectories": len(sweeps), "frames": sum(len(sweep) for sweep in sweeps)}
        if many:
            found["hearts"] = len({sweep.phantom for sweep in sweeps})
        wanted = {key: recorded.get(split, {}).get(key, 0) for key in found}
        if found != wanted:
            raise RacinesError(f"{split} has {found}, recorded {wanted}")
    return f"{len(survey)} frames in {len(survey.sweeps)} trajectories"


def check_content(survey: Survey, manifest: dict[str, Any]) -> str:
    """Check the content digest.

    Raises:
        RacinesError: the rows do not have it.
    """
    rows = ((sweep.split, sweep.id, sweep.digest) for sweep in survey.sweeps)
    wanted = config_digest(manifest, survey.config)
    if content_digest(rows) != wanted:
        raise RacinesError("the rows do not have the recorded content digest")
    return wanted[:16]


def check_splits(survey: Survey, root: Path, manifest: dict[str, Any]) -> str:
    """Check that no trajectory, and in `multi_phantom` no heart, is in two splits.

    Raises:
        RacinesError: one is, or the config `trajectories` or `sessions` says otherwise.
    """
    _check_apart("trajectory", [(sweep.id, sweep.split) for sweep in survey.sweeps])
    if survey.config == MULTI_PHANTOM:
        _check_apart("heart", [(f"{sweep.phantom}", sweep.split) for sweep in survey.sweeps])
        hearts = len({sweep.phantom for sweep in survey.sweeps})
        return f"{hearts} hearts, each in one split"
    _check_listed(survey, root, manifest)
    held = manifest["held_out_session"]
    if "sessions" in manifest["configs"]:
        _check_held_out(root, manifest["configs"]["sessions"], held)
    note = f"; session {held} held out in `sessions`" if held else ""
    return f"{len(survey.sweeps)} trajectories, each in one split{note}"


def _check_apart(kind: str, pairs: list[tuple[str, str]]) -> None:
    seen: dict[str, str] = {}
    for name, split in pairs:
        if seen.setdefault(name, split) != split:
            raise RacinesError(f"{kind} {name} is in {split} and in {seen[name]}")
    if kind == "trajectory" and len(seen) < len(pairs):
        raise RacinesError("a trajectory occurs twice in its split")


def _check_listed(survey: Survey, root: Path, manifest: dict[str, Any]) -> None:
    keys = ("trajectory", "session", "target_view", "phantom", "split", "frames", "digest")
    listed = {
        row["trajectory"]: tuple(row[key] for key in keys)
        for names in manifest["configs"]["trajectories"].values()
        for name in names
        for row in pq.read_table(root / name).to_pylist()
    }
    found = {
        s.id: (s.id, s.session, s.target_view, s.phantom, s.split, len(s), s.digest)
        for s in survey.sweeps
    }
    if found != listed:
        odd = sorted(name for name in {*found, *listed} if found.get(name) != listed.get(name))
        raise RacinesError(
            f"configs `frames` and `trajectories` disagree on {odd[0]} and {len(odd) - 1} others"
        )


def _check_held_out(root: Path, splits: dict[str, list[str]], held: str | None) -> None:
    for split, names in splits.items():
        for name in names:
            column = pq.read_table(root / name, columns=["session"])["session"]
            sessions = set(column.unique().to_pylist())
            if (sessions != {held}) if split == "test" else (held in sessions):
                raise RacinesError(
                    f"config `sessions` has {', '.join(sorted(sessions))} in {split}, where "
                    f"{held} is the one held out"
                )


def check_times(survey: Survey) -> str:
    """Check that time goes forward in each trajectory.

    Raises:
        RacinesError: it stands still or goes back.
    """
    for sweep in survey.sweeps:
        if (np.diff(sweep.timestamps) <= 0).any():
            row = int(np.flatnonzero(np.diff(sweep.timestamps) <= 0)[0])
            raise RacinesError(f"trajectory {sweep.id}: time does not go on after frame {row}")
    total = sum(float(sweep.timestamps[-1] - sweep.timestamps[0]) for sweep in survey.sweeps)
    return f"increasing in every trajectory, {total:.0f} s in all"


def check_rate(survey: Survey) -> str:
    """Check that all frames are equally far apart in time.

    Raises:
        RacinesError: some are not: frames were lost, or the clock wavers.
    """
    steps = [np.diff(sweep.timestamps) for sweep in survey.sweeps if len(sweep) > 1]
    if not steps:
        return "no trajectory has two frames"
    step = float(np.median(np.concatenate(steps)))
    for sweep, each in zip((s for s in survey.sweeps if len(s) > 1), steps, strict=True):
        off = np.abs(each / step - 1)
        if not (off <= RATE_TOLERANCE).all():
            row = int(np.argmax(off))
            raise RacinesError(
                f"trajectory {sweep.id}: {each[row]:.4g} s after frame {row}, elsewhere {step:.4g}"
            )
    return f"{1 / step:.4g} frames a second throughout"
