"""Checks of what the frames of simulated patients have besides: phases, masks, measures, people.

The paper's table is of one block. The reference here is of many patients: each parameter's mean and
standard deviation over sweeps of the train patients 1-60. Still and beating hearts are swept alike.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.patients.patient import PATHOLOGIES, PATIENTS_VERSION
from racines_data.patients.pool import Pool
from racines_data.validate.meaning import HEARTS, Rejudged
from racines_data.validate.survey import CheckedSweep, Survey
from racines_data.views import ParameterStatistics

ENOUGH = 40
"""Patients from which the reference has to hold; fewer are a rough sample."""
MEAN_LIMIT = 0.35  # largest difference of means, in standard deviations of the reference
STD_RATIO = (0.75, 1.33)  # smallest and largest ratio of standard deviations
REFERENCE = {
    "force_x": (0.0023, 6.3498),
    "force_y": (-1.2861, 7.1114),
    "force_z": (-9.6707, 5.7839),
    "torque_x": (-0.2641, 1.4078),
    "torque_y": (0.1619, 1.2237),
    "torque_z": (0.1031, 0.4542),
    "position_x": (0.4969, 0.0665),
    "position_y": (0.0431, 0.0457),
    "position_z": (0.0630, 0.0108),
    "rotation_y": (0.0749, 0.2664),
    "rotation_z": (-0.8794, 0.8452),
}
"""Mean and standard deviation of each parameter; N, N·m, m, and rad. rotation_x is left out: it
jumps between -π and π."""
VOLUMES = ("lv", "myocardium", "la", "rv", "rv_wall", "ra")
MOST_ML = 600.0
"""Volume beyond which nothing in a heart is plausible."""


def check_phases(survey: Survey, config: str) -> str:
    """Check that phases lie in [0, 1), and that hearts said to stand still do."""
    for sweep in survey.sweeps:
        phases = sweep.phases
        if phases is None or not ((phases >= 0) & (phases < 1)).all():
            raise RacinesError(f"trajectory {sweep.id}: a phase lies outside [0, 1)")
        if config == "patients" and phases.any():
            raise RacinesError(f"trajectory {sweep.id}: a still heart with a phase that is not 0")
    spans = [np.ptp(sweep.phases, axis=0) for sweep in survey.sweeps if sweep.phases is not None]
    if config != "patients" and not all(span.any() for span in spans):
        raise RacinesError("a heart that should beat stands still")
    return "0 throughout: end diastole, breathed out" if config == "patients" else "in [0, 1)"


def check_masks(survey: Survey, labels: Sequence[str]) -> str:
    """Check that all frames have masks or none has, and that their numbers are labels."""
    if not labels:
        if any(sweep.mask_labels for sweep in survey.sweeps):
            raise RacinesError("frames have masks, but the manifest names no labels")
        return "none"
    seen: set[int] = set()
    for sweep in survey.sweeps:
        if not sweep.mask_labels:
            raise RacinesError(f"trajectory {sweep.id}: its frames lack masks")
        if (most := max(sweep.mask_labels)) >= len(labels):
            raise RacinesError(
                f"trajectory {sweep.id}: a mask has the number {most}; labels end at "
                f"{len(labels) - 1}"
            )
        seen.update(sweep.mask_labels)
    return f"{len(seen)} of {len(labels)} labels occur"


def check_measures(measures: pa.Table) -> str:
    """Check that volumes, fractions and lengths of the patients are those of hearts."""
    for row in measures.to_pylist():
        who = f"patient {row['patient']}"
        if not 0.05 < row["ejection_fraction"] < 0.9:
            raise RacinesError(f"{who}: ejection fraction {row['ejection_fraction']:.3g}")
        for part in VOLUMES:
            volumes = row[f"volume_{part}"]
            if len(volumes) != len(row["phases"]) or not all(0 < v < MOST_ML for v in volumes):
                raise RacinesError(f"{who}: volumes of {part} that no heart has: {volumes[:3]}")
        lv = row["volume_lv"]
        if abs(1 - lv[-1] / lv[0] - row["ejection_fraction"]) > 1e-6:
            raise RacinesError(f"{who}: the ejection fraction is not that of the volumes")
        if "heart_axes" not in row:
            raise RacinesError(f"{who}: no heart_axes: built by an earlier version, build it anew")
        if not _turns(row["heart_axes"]):
            raise RacinesError(f"{who}: heart_axes are no axes of a right-handed frame")
        if row["pathology"] not in PATHOLOGIES:
            raise RacinesError(f"{who}: unknown pathology {row['pathology']!r}")
    fractions = measures["ejection_fraction"].to_numpy()
    return (
        f"{len(measures)} patients, ejection fraction {fractions.min():.2f}-{fractions.max():.2f}"
    )


def _turns(axes: Sequence[float]) -> bool:
    """Return whether nine numbers are a rotation, row by row."""
    if len(axes) != 9:
        return False
    matrix = np.reshape(axes, (3, 3))
    near = np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
    return bool(near and np.linalg.det(matrix) > 0.0)


def check_people(survey: Survey, measures: pa.Table) -> str:
    """Check that the table of measures is of the patients scanned, each in its split."""
    scanned = dict.fromkeys((sweep.patient, sweep.split) for sweep in survey.sweeps)
    listed = list(zip(*measures.select(["patient", "split"]).to_pydict().values(), strict=True))
    if sorted(listed) != sorted(scanned):
        odd = sorted({*listed} ^ {*scanned})
        one = f"patient {odd[0][0]} of {odd[0][1]}" if odd else "a patient twice"
        raise RacinesError(f"frames and measures are not of the same patients: {one}")
    sick = sum(kind != PATHOLOGIES[0] for kind in measures["pathology"].to_pylist())
    women = sum(measures["female"].to_pylist())
    return f"{len(listed)} patients, {women} female, {sick} with a pathology"


def must_meet_reference(manifest: Mapping[str, Any]) -> bool:
    """Return whether a departure from the reference is a fault: with many patients."""
    return sum(each["patients"] for each in manifest["counts"]["splits"].values()) >= ENOUGH


def check_reference(statistics: Mapping[str, ParameterStatistics]) -> str:
    """Check the mean and the spread of each parameter against those of the reference."""
    faults: list[str] = []
    for name, (mean, std) in REFERENCE.items():
        ours = statistics.get(name)
        if ours is None:
            faults.append(f"{name} was not measured")
            continue
        off, ratio = abs(ours.mean - mean) / std, ours.std / std
        if off > MEAN_LIMIT:
            faults.append(f"{name}: mean off by {off:.2f} std")
        if not STD_RATIO[0] <= ratio <= STD_RATIO[1]:
            faults.append(f"{name}: std x {ratio:.2f}")
    if faults:
        raise RacinesError("; ".join(faults))
    return f"{len(REFERENCE)} parameters as over the reference's patients"


def rejudge(survey: Survey, manifest: Mapping[str, Any]) -> Rejudged | str:
    """Judge frames of some patients again, from their measured poses and their phases."""
    if manifest["version"] != PATIENTS_VERSION:
        return f"labels of {manifest['version']}; the oracle here is {PATIENTS_VERSION}"
    known = sorted({sweep.patient for sweep in survey.sweeps if sweep.patient is not None})
    place = np.linspace(0, len(known) - 1, min(HEARTS, len(known))).round().astype(int)
    kept = [known[i] for i in place]
    sweeps = [sweep for sweep in survey.sweeps if sweep.patient in kept]
    pool = Pool(kept, beating=survey.config == "beating")
    found = [_judge_again(pool, sweep) for sweep in sweeps]
    views, grades = (np.concatenate(each) for each in zip(*found, strict=True))
    own_views = np.concatenate([sweep.views for sweep in sweeps])
    own_grades = np.concatenate([sweep.grades for sweep in sweeps])
    same = views == own_views
    of_view = same & (own_grades > 0)
    error = float(np.median(np.abs(grades - own_grades)[of_view])) if of_view.any() else None
    return Rejudged(len(views), float(same.mean()), error)


def _judge_again(pool: Pool, sweep: CheckedSweep) -> tuple[np.ndarray, np.ndarray]:
    """Return (T,) views and grades of a trajectory, whose patient is one of the pool's."""
    rows = torch.full((len(sweep),), pool.seeds.index(int(sweep.patient or 0)))
    phase = None if sweep.phases is None else torch.from_numpy(sweep.phases)
    pose = parameters_to_pose(torch.from_numpy(sweep.parameters))
    truth = pool.judge(pose, rows, phase)
    return truth.view.numpy(), truth.grade.numpy()
