"""What tracks are made of: the columns of their tables, and how their systems take places."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from racines_models.statistics import LEVEL


@dataclass(frozen=True)
class Column:
    """A metric as the tables show it."""

    key: str
    label: str
    better: str
    """`higher`, `lower`, or `none` for a metric that is shown and not judged."""
    digits: int = 3
    scale: float = 1.0
    unit: str = ""
    track: str = "generators"
    """Of a column of another package: the track whose tables it stands in."""
    value: Callable[[dict[str, Any]], dict[str, Any] | None] | None = None
    """Instead of the metric `key`: what a column makes of a record, as `racines:metric`."""

    @property
    def title(self) -> str:
        """The label with its arrow and unit."""
        arrow = {"higher": " ↑", "lower": " ↓", "none": ""}[self.better]
        return f"{self.label}{f' ({self.unit})' if self.unit else ''}{arrow}"

    def improves(self, first: float, second: float) -> bool:
        """Return whether the first value is better than the second."""
        return first > second if self.better == "higher" else first < second


@dataclass(frozen=True)
class Track:
    """One table of a board."""

    name: str
    schema: str
    """Kind of the scores file."""
    subject: str
    """Key of the system's name in the scores file."""
    columns: tuple[Column, ...]
    ranked_by: tuple[str, ...]
    """Keys of the columns that the score is the mean of, each between the board's anchors."""
    anchors: tuple[str, ...]
    """Names of the methods whose metrics are 0 and 1; the latter is left out where `exact` is."""
    bounds: tuple[str, ...]
    """Methods that stand on the board without a place."""
    rule: str
    counted: str
    """What n counts."""
    unit: str
    """What was drawn independently, which intervals resample."""
    details: tuple[Column, ...] = ()
    """Further metrics, for a second table."""
    exact: float | None = None
    """What each ranked metric is of the truth, where that is known and so stands at 1."""
    own_starts: bool = False
    """Whether each task has a start set of its own; else a board has one."""

    @property
    def steers(self) -> bool:
        """Whether its systems are agents, which have a task each."""
        return self.subject == "agent"

    def ranked_columns(self) -> list[Column]:
        """Return the columns of `ranked_by`."""
        columns = {column.key: column for column in self.columns}
        return [columns[key] for key in self.ranked_by]


PERCENT = f"{100 * LEVEL:g} %"
"""Nominal coverage of the intervals, as captions say it."""
TRAININGS = 3
"""Fewest trainings with which a trained system takes a place."""
PLACES = (
    f"Ahead is who has the higher score, with a paired {PERCENT} interval of the difference that "
    "leaves out 0; a place is 1 and how many are ahead, shared places are marked =. Bounds, a "
    f"trained system of fewer than {TRAININGS} trainings, and one without evidence have no place."
)
"""How a rule ends: who is ahead of whom, and who has no place."""
