"""What views and grades may say of a frame together: only a known view is graded, by 1 to 10."""

from collections.abc import Sequence

import numpy as np

from racines_data.views import RANDOM


def label_fault(
    views: np.ndarray, grades: np.ndarray, labels: Sequence[str]
) -> tuple[int, str] | None:
    """Return the first frame whose grade does not go with its view, and what it is; else None.

    Args:
        views: (T,) labels, -1 where unknown.
        grades: (T,) grades, NaN where unknown.
        labels: Names of the views, `Random` last. Frames of `Random` have grade 0, or none.
    """
    random, graded = list(labels).index(RANDOM), ~np.isnan(grades)
    shown = (views >= 0) & (views != random)
    wrong = {
        "Random, yet graded": graded & (views == random) & (grades != 0),
        "of a view, graded outside 1-10": graded & shown & ((grades < 1) | (grades > 10)),
        "graded, of unknown view": graded & (views < 0),
    }
    for what, rows in wrong.items():
        if rows.any():
            return int(np.flatnonzero(rows)[0]), what
    return None
