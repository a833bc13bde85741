"""One figure of a robustness study: the share found and declared with one thing wrong.

It is the mean over the disturbances one at a time, at the middle strength: not all at once, under
which nearly nobody finds anything, so that agents would not be told apart; and no share of what is
found with nothing wrong, since an agent that looks at no picture loses nothing to haze, and would
lead by finding little.
"""

from typing import Any

import numpy as np

from racines_envs.studies.robustness.disturbances import STRENGTHS
from racines_envs.studies.robustness.run import ALL, NOTHING
from racines_models.statistics import Evidence

MIDDLE = STRENGTHS[1]


def found_disturbed(document: dict[str, Any]) -> dict[str, Any]:
    """Return the mean share found and declared over single disturbances at the middle strength.

    Args:
        document: A robustness report. `patients` names the patient of each of N starts, `found`
            says by condition, of R trainings and N starts, who was found and declared.

    Returns:
        A metric: `value`, `low`, `high`, `n`, `settings`. An episode's figure is its mean over the
        disturbances; patients are the units of the interval.

    Raises:
        ValueError: no condition of the middle strength, or lists of unequal lengths.
    """
    units = np.asarray(document["patients"], np.int32)
    alone = [row["found"] for row in single(document).values()]
    found = np.asarray(alone, np.float64).mean(0)  # (R, N)
    places = np.arange(len(units))
    figures = Evidence().add("found", "mean", found[:, None], places, units, 0.0, 1.0)
    return figures.interval().to_json()


def single(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the conditions with one thing wrong at the middle strength, by its name."""
    rows = document["conditions"].values()
    return {
        row["name"]: row
        for row in rows
        if row["strength"] == MIDDLE and row["name"] not in (NOTHING, ALL)
    }
