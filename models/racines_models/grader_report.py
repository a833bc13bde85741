"""How the grader's labels and grades compare with the truth, on held-out trajectories."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from racines_data.store import FrameStore
from racines_data.views import LABELS, RANDOM_LABEL
from racines_models.bootstrap import bootstrap_mean
from racines_models.grader import Grader

CLOSE = 1.0
"""Grades that differ by no more agree."""


class Comparison(NamedTuple):
    """One figure's value on each frame."""

    values: Tensor
    """(N,) float64, NaN where the truth is unknown or the figure does not apply."""
    rule: str
    unit: str | None = None


def compare(
    label: Tensor, grade: Tensor, views: Tensor, grades: Tensor, random: int = RANDOM_LABEL
) -> dict[str, Comparison]:
    """Compare (N,) labels and grades with the true ones; a figure without any truth is absent.

    `random` is the label of `Random`, whose grades say nothing.
    """
    known = views >= 0
    target = known & (views != random)
    error = (grade - grades).abs().double()
    close = torch.where(error.isfinite(), (error <= CLOSE).double(), torch.nan)
    unit = "grades of 10"
    compared = {
        "view_agreement": Comparison(
            _where(known, (label == views).double()), "the grader's label is the true one"
        ),
        "grade_agreement": Comparison(
            _where(target, close), f"grades differ by at most {CLOSE:g}, frames of a view"
        ),
        "grade_error": Comparison(
            _where(target, error), "mean absolute difference, frames of a view", unit
        ),
        "grade_error_all": Comparison(error, "mean absolute difference, all frames", unit),
    }
    return {k: each for k, each in compared.items() if bool(each.values.isfinite().any())}


def report(grader: Grader, store: FrameStore, split: str = "test") -> dict[str, Any]:
    """Judge a split and compare with its labels.

    Returns:
        `split`; `metrics`: `view_accuracy`, `grade_mae` (frames of a view), `grade_mae_all`,
        `grade_agreement`, each with value, low, high, n; `views`: the accuracy on each label's
        frames; `confusion`: counts, rows the truth.

    Raises:
        RacinesError: the grader was trained for other views.
    """
    grader.check_labels(store.labels, "the dataset")
    rows = store.split_indices(split)
    frames = store.take(rows)
    label, grade, _ = grader.judge(frames.images)
    trajectory = store.trajectory_index[rows].numpy()
    names = {"view_agreement": "view_accuracy", "grade_error": "grade_mae"}
    names |= {"grade_error_all": "grade_mae_all"}
    random = len(store.labels) - 1
    compared = compare(label, grade, frames.views, frames.grades, random)
    metrics = {
        names.get(name, name): bootstrap_mean(each.values.numpy(), trajectory).to_json(
            each.unit, rule=each.rule
        )
        for name, each in compared.items()
    }
    views = {}
    for index, name in enumerate(store.labels):
        chosen = (frames.views == index).numpy()
        if chosen.any():
            right = compared["view_agreement"].values.numpy()[chosen]
            views[name] = bootstrap_mean(right, trajectory[chosen]).to_json()
    counts = confusion_counts(label, frames.views, len(store.labels))
    confusion = {"labels": list(store.labels), "counts": counts}
    return {"split": split, "metrics": metrics, "views": views, "confusion": confusion}


def confusion_counts(label: Tensor, truth: Tensor, labels: int = len(LABELS)) -> list[list[int]]:
    """Count (N,) labels by truth (row) and label (column); frames of unknown view are left out."""
    known = truth >= 0
    pairs = truth[known] * labels + label[known]
    return torch.bincount(pairs, minlength=labels**2).view(labels, -1).tolist()


def _where(chosen: Tensor, values: Tensor) -> Tensor:
    return torch.where(chosen, values, torch.nan)
