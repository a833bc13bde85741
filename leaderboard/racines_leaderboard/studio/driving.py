"""Driving the probe by hand: whose episode it is, and the live environment behind it.

A visitor's state is `Session`, plain values. The environment that stands where its actions lead is
kept on the server under the session's token; one that was given up is made again by replaying the
actions, since an episode follows from its start and actions alone.
"""

import secrets
import threading
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import torch

from racines_envs.apis.rendering import History
from racines_envs.robots.arm import FREE, ROBOTS
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import TASKS
from racines_envs.worlds.making import make_core
from racines_leaderboard.studio import inputs
from racines_leaderboard.studio.parts import Place, Shared, load_grader, load_phantom
from racines_leaderboard.studio.scene import Curve, Scene, judged, snapshot, take_scene

FIXED, SEEDED = "evaluation", "seed"
KINDS = (FIXED, SEEDED)
"""How a start is named: by its number among the fixed starts of evaluations, or by a seed."""
FIXED_STARTS = 100


@dataclass(frozen=True)
class Session:
    """One visitor's episode."""

    token: str
    """Drawn at random: nobody meets another's environment."""
    task: str
    kind: str
    number: int
    robot: str = FREE
    actions: tuple[int, ...] = ()


def robots() -> tuple[str, ...]:
    """Return what may carry the probe: nothing, and registered arms where their extra is there."""
    return (FREE, *(ROBOTS.names() if find_spec("pytorch_kinematics") else ()))


def begin(task: Any, kind: Any, number: Any, robot: Any = FREE) -> Session:
    """Return a session at its start; raise a `RacinesError` for what was not offered."""
    robot = inputs.choice(robot, robots(), "robot")
    task, kind = inputs.choice(task, tuple(TASKS), "task"), inputs.choice(kind, KINDS, "start")
    greatest = FIXED_STARTS - 1 if kind == FIXED else inputs.GREATEST_SEED
    number = inputs.whole(number, 0, greatest, "number of the start")
    return Session(secrets.token_urlsafe(16), task, kind, number, robot)


def reset_seed(kind: str, number: int) -> Any:
    """Return what a core of one row is reset with for a start."""
    return evaluation_seeds(number + 1)[-1:] if kind == FIXED else number


def core_and_grader(
    place: Place, task: str, observation: str, encoder: Any = None, robot: str = FREE
) -> tuple[Any, Any]:
    """Return a task's core of one row, rewarded by the truth, and the grader of its images."""
    core = make_core(
        TASKS[task], observation=observation, reward="oracle", device=place.device,
        phantom=load_phantom(place, TASKS[task].anatomy), encoder=encoder, robot=robot,
    )  # fmt: skip
    return core, load_grader(place, core.phantom.labels)


class Live:
    """One environment that somebody drives, with what the grader says of each image."""

    def __init__(self, place: Place, session: Session) -> None:
        """Make it, and take the session's actions."""
        self.lock = threading.Lock()
        self.core, self._grader = core_and_grader(place, session.task, "image", robot=session.robot)
        self._history = History(1)
        self._images: list[Any] = []
        self._judged: tuple[list[float], list[float]] = [], []
        self.core.reset(reset_seed(session.kind, session.number))
        self._note(None)
        for action in session.actions:
            self.step(action)

    @property
    def actions(self) -> tuple[Any, ...]:
        """What was done since the start."""
        return tuple(self._history[0].actions[1:])

    def step(self, action: int) -> None:
        """Take one of the 13 actions; nothing happens once the episode is over."""
        if not bool(self.core.state.done[0]):
            chosen = torch.tensor([action], device=self.core.device)
            self.core.step(chosen)
            self._note(chosen)

    def scene(self, truth: bool) -> Scene:
        """Return the present moment; without `truth` the grader's word alone, if there is one."""
        curves, steps = [], self._history[0]
        if self._grader is not None:
            if self._images:  # all that came since it last looked, at once
                p, grades = judged(self._grader, self._images, self.core.task.target)
                self._judged = self._judged[0] + p, self._judged[1] + grades
                self._images.clear()
            curves.append(Curve("grader", *self._judged))
        if truth:
            curves.append(Curve("truth", tuple(steps.probabilities), tuple(steps.grades)))
        return take_scene(self.core, snapshot(self.core), steps, curves, truth)

    def _note(self, action: Any) -> None:
        self._history.note(self.core, action)
        if self._grader is not None:
            self._images.append(self.core.picture())


class Lives:
    """The live environments of all visitors, `place.max_sessions` at most."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._kept: Shared[Live] = Shared(place.max_sessions)

    def __len__(self) -> int:
        return len(self._kept)

    def look(self, session: Session, truth: bool) -> Scene:
        """Return the session's present moment."""
        live = self._at(session)
        with live.lock:
            return live.scene(truth)

    def step(self, session: Session, action: int, truth: bool) -> tuple[Session, Scene]:
        """Take one action; return the session after it, unchanged if its episode is over."""
        live = self._at(session)
        with live.lock:
            live.step(action)
            return replace(session, actions=live.actions), live.scene(truth)

    def _at(self, session: Session) -> Live:
        """Return the environment that stands where the session's actions lead."""
        live = self._kept.get(session.token, lambda: Live(self._place, session))
        if live.actions != session.actions:  # the session is what counts
            live = Live(self._place, session)
            self._kept.put(session.token, live)
        return live
