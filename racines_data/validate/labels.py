"""Checks of views, grades and what a grader made of the frames."""

from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.validate.survey import Survey
from racines_data.views import RANDOM


def check_labels(survey: Survey, labels: tuple[str, ...]) -> str:
    """Check that views, grades and targets go together.

    Raises:
        RacinesError: a target that is no label; a `Random` frame with a grade above 0, a view's
            grade outside 1-10, or a grade where the view is unknown.
    """
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
    counts = np.bincount(views[known], minlength=len(labels)) / known.sum()
    on_target = {}
    for index, label in enumerate(labels):
        chosen = known & (target == label)
        if chosen.any():
            on_target[label] = float((views[chosen] == index).mean())
    return {
        "frames": {label: float(share) for label, share in zip(labels, counts, strict=True)},
        "on_target": on_target,
    }


def check_views(shares: dict[str, Any]) -> str:
    """Check that the sweeps to each view show it.

    Raises:
        RacinesError: the sweeps to a view never do.
    """
    if not shares["on_target"]:
        return "no frame of a targeted sweep has a view"
    lost = [view for view, share in shares["on_target"].items() if view != RANDOM and not share]
    if lost:
        raise RacinesError(f"no sweep to {', '.join(lost)} ever shows it")
    parts = [f"{view} {share:.0%}" for view, share in shares["on_target"].items()]
    return f"frames that show what their sweep aims at: {', '.join(parts)}"


def check_annotation(survey: Survey, manifest: dict[str, Any], labels: tuple[str, ...]) -> str:
    """Check that all frames have a grader's view and grade, or none has.

    Raises:
        RacinesError: some do and some do not, against the manifest, or one is out of range.
    """
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
