"""Judging a sample of simulated frames again, from their measured poses."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.phantom.recorded import phantom_settings
from racines_data.validate.survey import Survey

SAMPLE = 2048
"""Frames judged again, at even distances over the whole config."""
HEARTS = 3
"""Hearts of `multi_phantom` judged again: each has to be made first, which takes seconds."""
VIEW_AGREEMENT = 0.97
"""Least share of equal views. The recorded pose has the sensor's noise, the recorded label is of
the true pose: frames at the edge of a view may fall to either side."""
GRADE_ERROR = 0.3
"""Largest median difference of grades, of frames with the same view."""


@dataclass(frozen=True)
class Rejudged:
    """How the labels of a dataset agree with what the oracle says of its poses."""

    n: int
    view_agreement: float
    grade_error: float | None
    """Median absolute difference over frames judged to be of the same view; None if there are
    none."""


def rejudge(survey: Survey, manifest: Mapping[str, Any]) -> Rejudged | str:
    """Judge a sample of poses with the oracle that the recipe names.

    Returns:
        The agreement; or why there is none: the source has no oracle, or this code has another
        version of it.

    Raises:
        RacinesError: the recipe's settings are unknown to this code.
    """
    from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig

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
        truth = _phantom(base, int(seed)).truth(parameters[torch.from_numpy(chosen)])
        judged_view[chosen], judged_grade[chosen] = truth.view.numpy(), truth.grade.numpy()
    same = judged_view == views
    of_view = same & (grades > 0)
    error = float(np.median(np.abs(judged_grade - grades)[of_view])) if of_view.any() else None
    return Rejudged(len(rows), float(same.mean()), error)


def _phantom(base: Any, seed: int) -> Any:
    from racines_data.phantom.model import Phantom
    from racines_data.phantom.population import heart_config

    return Phantom(base if seed == base.anatomy_seed else heart_config(base, seed))


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
    """Check the agreement of labels and oracle.

    Raises:
        RacinesError: too many views or grades differ.
    """
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
