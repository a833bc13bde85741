"""The tasks, as data: one a target view of an organ. A variant is `dataclasses.replace(…)`."""

from dataclasses import dataclass

from racines_data.errors import RacinesError
from racines_data.phantom.anatomy import anatomy_views
from racines_data.views import HEART, organs
from racines_envs.task.names import task_id, task_name

TERMINATIONS = ("first_hit", "k_hits", "timeout")


@dataclass(frozen=True)
class Task:
    """Find one standard view: from where, with what steps, within what limits, and until when."""

    view: str
    """The target view."""
    start_distance: tuple[float, float] = (0.025, 0.055)
    """Least and greatest distance of a start from the nominal pose along the block's top, m."""
    start_height: tuple[float, float] = (-0.002, 0.004)
    """Least and greatest height of a start above the nominal pose, m."""
    start_angle: tuple[float, float] = (0.2, 0.7)
    """Least and greatest rotation of a start from the nominal pose, about a random axis, rad."""
    step_translation: float = 0.003
    """A unit translation along an axis of the probe, m."""
    step_rotation: float = 0.06
    """A unit rotation about an axis of the probe, rad."""
    force_limit: float = 20.0
    """Greatest normal force, N; a step that would press harder becomes idle."""
    termination: str = "k_hits"
    """`first_hit`, `k_hits` (`hits` hits in a row) or `timeout` (never before `max_steps`)."""
    hits: int = 3
    """Hits in a row that end an episode under `k_hits`."""
    max_steps: int = 200
    """Steps after which an episode is truncated."""
    anatomy: str = HEART
    """Whose view it is: a registered anatomy, or `module:function`."""

    def __post_init__(self) -> None:
        views = anatomy_views(self.anatomy)
        if self.view not in views:
            raise RacinesError(f"unknown view {self.view!r}: choose one of {', '.join(views)}")
        if self.termination not in TERMINATIONS:
            known = ", ".join(TERMINATIONS)
            raise RacinesError(f"unknown termination {self.termination!r}: choose one of {known}")
        for name in ("step_translation", "step_rotation", "force_limit", "hits", "max_steps"):
            if not getattr(self, name) > 0:
                raise RacinesError(f"task {self.view}: {name} must be positive")

    @property
    def id(self) -> str:
        """The Gymnasium id."""
        return task_id(self.view, self.anatomy)

    @property
    def target(self) -> int:
        """The label of the target view."""
        return anatomy_views(self.anatomy).index(self.view)

    @property
    def hits_to_end(self) -> int:
        """Hits in a row that end an episode; 0 if none do."""
        return {"first_hit": 1, "k_hits": self.hits, "timeout": 0}[self.termination]


TASKS = {
    task_name(view, anatomy): Task(view, anatomy=anatomy)
    for anatomy, views in organs().items()
    for view in views
}
"""The tasks of the registered organs: `SC`, …, and `<organ>-<VIEW>`."""


def get_task(name: str, anatomy: str = HEART) -> Task:
    """Return a task by its name, or by the name of a view that an anatomy has."""
    view = name.removeprefix(f"{anatomy}-")
    return TASKS.get(task_name(view, anatomy)) or Task(view, anatomy=anatomy)
