"""A metric of generators as a plug-in: one `Metric` in one file, and one entry point.

Every installed metric is taken by `racines eval generator`, stands in the scores file by its name,
and is a column of the board. It never ranks.

    [project.entry-points."racines.metrics"]
    blackness = "my_package.blackness:BLACKNESS"
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from racines_data.plugins import Plugins


@dataclass(frozen=True)
class Metric:
    """A metric, as data."""

    name: str
    """Key in the scores file; no other metric's."""
    label: str
    """Head of its column."""
    better: str
    """`higher`, `lower`, or `none` for what is shown and not judged."""
    measure: Callable[[Any, Any], Tensor | float]
    """Of images and their truth, both `Batch`es of N frames at the same poses, whose images differ:
    (N,) values, of which the mean is reported; or of `features`: one number for the whole set."""
    features: bool = False
    """`measure` takes (N, D) Inception features of drawn and of true images instead."""
    unit: str = ""
    digits: int = 3
    """Decimals in a table."""
    scale: float = 1.0
    """Multiplies the value in a table: 100 for %."""
    minimum: float = -math.inf
    """The least that the value can be: a record with less is refused."""
    maximum: float = math.inf
    """The most."""
    rule: str = ""
    """What it says, in half a sentence; kept with each value."""


METRICS = Plugins(
    "metric", "racines.metrics", ("name", "label", "better", "measure"), "module:METRIC"
)


def installed_metrics() -> list[Metric]:
    """Return the metrics that installed packages register, by name.

    Raises:
        RacinesError: one that cannot be imported, by its entry point.
    """
    return [METRICS.load(name) for name in METRICS.names()]
