"""Checks of views and grades: among themselves, against a grader's, and against the oracle's.

The oracle judges a sample of simulated frames again, from their measured poses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.phantom.config import (
    PHANTOM_VERSION,
    PhantomConfig,
    heart_config,
    phantom_settings,
)
from racines_data.phantom.model import Phantom
from racines_data.validate.survey import Survey
from racines_data.views import RANDOM

SAMPLE = 2048  # frames judged again, at even distances over the whole config
HEARTS = 3  # hearts of `multi_phantom` judged again: each has to be made first, which takes seconds
VIEW_AGREEMENT = 0.97
"""Least share of equal views. The recorded pose has the sensor's noise, the recorded label is of
the true pose: frames at the edge of a view may fall to either side."""
GRADE_ERROR = 0.3  # largest median difference of grades, of frames with the same view


def check_labels(survey: Survey, labels: tuple[str, ...]) -> str:
    """Check that targets are labels, and that only a known view is graded, by 1-10."""
    odd = sorted({sweep.target_view for sweep in survey.sweeps} - set(labels))
    if odd:
        raise RacinesError(f"target view {odd[0]!r} is none of {', '.join(labels)}")
    random = labels.index(RANDOM)
    for sweep in survey.sweeps:
        graded = ~np.isnan(sweep.grades)
        view = (sweep.views >= 0) & (sweep.views != random)
        _refuse(sweep.id, "Random, yet graded", graded & (sweep.views == random), sweep.grades > 0)
        outside = (sweep.grades < 1) | (sweep.grades > 10)
        _refuse(sweep.id, "of a view, graded outside 1-10", graded & view, outside)
        _refuse(sweep.id, "graded, of unknown view", graded, sweep.views < 0)
    views, grades = survey.column("views"), survey.column("grades")
    if not (views >= 0).any():
        return "no frame has a view or a grade"
    return (
        f"{(views >= 0).mean():.1%} of the frames have a view, "
        f"{(~np.isnan(grades)).mean():.1%} a grade"
    )


def _refuse(trajectory: str, what: str, chosen: np.ndarray, wrong: np.ndarray) -> None:
    rows = np.flatnonzero(chosen & wrong)
    if len(rows):
        raise RacinesError(f"trajectory {trajectory}: frame {rows[0]} is {what}")


def view_shares(survey: Survey, labels: tuple[str, ...]) -> dict[str, Any]:
    """Return the share of frames of each view, and, by target, the share that show the target."""
    views, target = survey.column("views"), survey.each("target_view")
    known = views >= 0
    if not known.any():
        return {"frames": {}, "on_target": {}}
    shares = np.bincount(views[known], minlength=len(labels)) / known.sum()
    aimed = {label: views[known & (target == label)] for label in labels}
    return {
        "frames": dict(zip(labels, shares.tolist(), strict=True)),
        "on_target": {
            label: float((aimed[label] == index).mean())
            for index, label in enumerate(labels)
            if len(aimed[label])
        },
    }


def check_views(shares: dict[str, Any]) -> str:
    """Check that sweeps to a view show it now and then."""
    if not shares["on_target"]:
        return "no frame of a targeted sweep has a view"
    lost = [view for view, share in shares["on_target"].items() if view != RANDOM and not share]
    if lost:
        raise RacinesError(f"no sweep to {', '.join(lost)} ever shows it")
    parts = [f"{view} {share:.0%}" for view, share in shares["on_target"].items()]
    return f"frames that show what their sweep aims at: {', '.join(parts)}"


def check_annotation(survey: Survey, manifest: dict[str, Any], labels: tuple[str, ...]) -> str:
    """Check that all frames have a grader's view and grade, or none has."""
    view, grade = survey.column("predicted").T
    present = ~np.isnan(view)
    if not np.array_equal(present, ~np.isnan(grade)):
        raise RacinesError("view_predicted and grade_predicted are not there together")
    annotation = manifest.get("annotation") if survey.config == "frames" else None
    if not annotation:
        if present.any():
            raise RacinesError(f"{present.sum()} frames are annotated, by no recorded grader")
        return "not annotated"
    if not present.all():
        raise RacinesError(f"annotated, yet {(~present).sum()} frames lack the grader's opinion")
    if ((view < 0) | (view >= len(labels)) | (grade < 0) | (grade > 10)).any():
        raise RacinesError("view_predicted is no label, or grade_predicted lies outside 0-10")
    return f"every frame, by grader {annotation['grader'][:16]}"


@dataclass(frozen=True)
class Rejudged:
    """How the labels of a dataset agree with what the oracle says of its poses."""

    n: int
    view_agreement: float
    grade_error: float | None  # median absolute difference over frames of the same view, if any


def rejudge(survey: Survey, manifest: Mapping[str, Any]) -> Rejudged | str:
    """Judge a sample of poses with the oracle that the recipe names; or say why there is none."""
    settings = phantom_settings(manifest, survey.config)
    if settings is None:
        return "the source has no oracle"
    if settings["version"] != PHANTOM_VERSION:
        return f"labels of phantom {settings['version']}; the oracle here is {PHANTOM_VERSION}"
    base = fill(PhantomConfig, settings["phantom"], "recipe: phantom")
    rows, seeds = _sample(survey)
    views, grades = survey.column("views")[rows], survey.column("grades")[rows]
    parameters = torch.from_numpy(survey.column("parameters")[rows])
    judged_view, judged_grade = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
    for seed in np.unique(seeds):
        chosen = np.flatnonzero(seeds == seed)
        config = base if seed == base.anatomy_seed else heart_config(base, int(seed))
        truth = Phantom(config).truth(parameters[torch.from_numpy(chosen)])
        judged_view[chosen], judged_grade[chosen] = truth.view.numpy(), truth.grade.numpy()
    same = judged_view == views
    of_view = same & (grades > 0)
    error = float(np.median(np.abs(judged_grade - grades)[of_view])) if of_view.any() else None
    return Rejudged(len(rows), float(same.mean()), error)


def _sample(survey: Survey) -> tuple[np.ndarray, np.ndarray]:
    """Return rows, evenly spread over at most `HEARTS` seeds of the anatomy, and their seeds."""
    seeds = survey.each("phantom").astype(np.int64)
    known = np.unique(seeds)
    kept = known[np.linspace(0, len(known) - 1, min(HEARTS, len(known))).round().astype(int)]
    rows = np.flatnonzero(np.isin(seeds, kept))
    if len(rows) > SAMPLE:
        rows = rows[(np.arange(SAMPLE) * len(rows) + len(rows) // 2) // SAMPLE]
    return rows, seeds[rows]


def check_rejudged(found: Rejudged | str) -> str:
    """Check the agreement of labels and oracle."""
    if isinstance(found, str):
        return f"not judged again: {found}"
    said = f"{found.view_agreement:.1%} of {found.n} views judged the same again"
    if found.grade_error is not None:
        said += f", grades off by {found.grade_error:.2f} (median)"
    if found.view_agreement < VIEW_AGREEMENT:
        raise RacinesError(f"{said}; {VIEW_AGREEMENT:.0%} are expected")
    if found.grade_error is not None and found.grade_error > GRADE_ERROR:
        raise RacinesError(f"{said}; {GRADE_ERROR} at most is expected")
    return said
