"""The tasks, as data: one a target view of an organ. A variant is `dataclasses.replace(…)`."""

from dataclasses import asdict, dataclass
from typing import Any

from racines_data.errors import RacinesError
from racines_data.phantom.anatomy import anatomy_views
from racines_data.views import HEART, labels_of, organs
from racines_envs.task.names import (
    ANY_VIEW,
    GOALS,
    HEART_TIER,
    REPLAY_ID,
    TIERS,
    task_id,
    task_name,
)

TERMINATIONS = ("first_hit", "k_hits", "timeout")
"""Ends that are found by looking on."""
DECLARED = "declared"
"""The end that the agent says: so many idle steps in a row."""


@dataclass(frozen=True)
class Task:
    """Find one standard view: from where, with what steps, within what limits, and until when."""

    view: str
    """The target view; `AnyView` on patients: drawn for each episode."""
    start_distance: tuple[float, float] = (0.025, 0.055)
    """Least and greatest distance of a start from the nominal pose along the block's top, m; on
    patients from the view's middle, as height and angle are (see `tiers`)."""
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
    """`first_hit`, `k_hits` (`hits` hits in a row), `timeout` (never before `max_steps`), or
    `declared`: by `idles` idle steps in a row the agent says that it is there."""
    hits: int = 3
    """Hits in a row that end an episode under `k_hits`, and by which a view counts as reached."""
    idles: int = 3
    """Idle steps in a row that declare."""
    max_steps: int = 200
    """Steps after which an episode is truncated."""
    anatomy: str = HEART
    """Whose view it is: a registered anatomy, or `module:function`."""
    tier: str = HEART_TIER
    """In which world: `heart`, `patients` (still) or `beating`."""
    views: tuple[str, ...] = ()
    """The views that recordings tell apart, which stand alone (`worlds.recorded`); else empty: the
    anatomy has them."""

    def __post_init__(self) -> None:
        _check_known("tier", self.tier, TIERS)
        views = self.known_views if self.tier == HEART_TIER else GOALS
        _check_known("view", self.view, views)
        _check_known("termination", self.termination, (*TERMINATIONS, DECLARED))
        if self.tier != HEART_TIER and self.anatomy != HEART:
            raise RacinesError(f"tier {self.tier!r} has no {self.anatomy}: only the heart's views")
        numbers = ("step_translation", "step_rotation", "force_limit", "hits", "idles", "max_steps")
        for name in numbers:
            if not getattr(self, name) > 0:
                raise RacinesError(f"task {self.view}: {name} must be positive")

    @property
    def id(self) -> str:
        """The Gymnasium id; that of all replays where there are no more than recordings."""
        return REPLAY_ID if self.views else task_id(self.view, self.anatomy, self.tier)

    @property
    def name(self) -> str:
        """What commands and settings call it."""
        return task_name(self.view, self.anatomy, self.tier)

    @property
    def definition(self) -> dict[str, Any]:
        """What documents say of it; of the one heart's tasks what they said before patients."""
        later = () if self.tier != HEART_TIER else ("idles", "tier")
        later = later if self.views else (*later, "views")
        return {name: value for name, value in asdict(self).items() if name not in later}

    @property
    def any_view(self) -> bool:
        """Whether the goal is drawn for each episode, and observed."""
        return self.view == ANY_VIEW

    @property
    def known_views(self) -> tuple[str, ...]:
        """The views that can be looked for: those of the recordings or of the anatomy."""
        return self.views or anatomy_views(self.anatomy)

    @property
    def labels(self) -> tuple[str, ...]:
        """These views, then `Random`."""
        return labels_of(self.known_views)

    @property
    def target(self) -> int:
        """The label of the target view; `RacinesError` where episodes differ in it."""
        if self.any_view:
            raise RacinesError(f"{self.id} has no one target view: it is drawn for each episode")
        return self.known_views.index(self.view)

    @property
    def hits_to_end(self) -> int:
        """Hits in a row that end an episode; 0 if none do."""
        return {"first_hit": 1, "k_hits": self.hits}.get(self.termination, 0)


def _check_known(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise RacinesError(f"unknown {what} {value!r}: choose one of {', '.join(known)}")


def _patients_task(view: str, tier: str) -> Task:
    """Return a task on patients: it starts about the view's middle, and the agent ends it."""
    own: dict[str, Any] = {"start_distance": (0.010, 0.050), "start_angle": (0.1, 0.5)}
    return Task(view, tier=tier, termination=DECLARED, **own)


TASKS = {
    task_name(view, anatomy): Task(view, anatomy=anatomy)
    for anatomy, views in organs().items()
    for view in views
}
"""The tasks of the registered organs: `SC`, …, and `<organ>-<VIEW>`."""

PATIENT_TASKS = {
    task_name(view, tier=tier): _patients_task(view, tier)
    for tier in TIERS
    if tier != HEART_TIER
    for view in GOALS
}
"""The tasks on any patient: `SC-patients`, …, `AnyView-patients`, and the same `-beating`."""


def get_task(name: str, anatomy: str = HEART) -> Task:
    """Return a task by its name, or by the name of a view that an anatomy has."""
    if name in PATIENT_TASKS:
        return PATIENT_TASKS[name]
    view = name.removeprefix(f"{anatomy}-")
    # A folder of one's own may be called as a registered organ is.
    known = TASKS.get(task_name(view, anatomy)) if anatomy in organs() else None
    return known or Task(view, anatomy=anatomy)
