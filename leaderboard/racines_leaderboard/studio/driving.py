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
from racines_leaderboard.studio import worlds
from racines_leaderboard.studio.parts import Place, Shared
from racines_leaderboard.studio.scene import Curve, Scene, judged, snapshot, take_scene
from racines_leaderboard.studio.worlds import FIRST_PATIENT, Start

SCANNED = 12
"""Visitors whose environment of a patient is kept: each heart takes 20 MB."""


@dataclass(frozen=True)
class Session:
    """One visitor's episode."""

    token: str
    """Drawn at random: nobody meets another's environment."""
    start: Start
    actions: tuple[int, ...] = ()


def robots() -> tuple[str, ...]:
    """Return what may carry the probe: nothing, and registered arms where their extra is there."""
    return (FREE, *(ROBOTS.names() if find_spec("pytorch_kinematics") else ()))


def begin(
    task: Any, kind: Any, number: Any, robot: Any = FREE, patient: Any = FIRST_PATIENT,
    actions: tuple[int, ...] = (),
) -> Session:  # fmt: skip
    """Return a session at its start, or where some actions lead.

    Raises:
        RacinesError: what was not offered.
    """
    start = worlds.start_of(task, kind, number, robot, patient, robots())
    return Session(secrets.token_urlsafe(16), start, actions)


class Live:
    """One environment that somebody drives, with what the grader says of each image."""

    def __init__(self, place: Place, session: Session) -> None:
        """Make it, and take the session's actions."""
        self.lock = threading.Lock()
        self.core, self._grader = worlds.core_and_grader(place, session.start, "image")
        self._history = History(1)
        self._images: list[Any] = []
        self._judged: tuple[list[float], list[float]] = [], []
        worlds.reset(self.core, session.start)
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
        most = place.max_sessions
        self._kept: dict[bool, Shared[Live]] = {
            False: Shared(most), True: Shared(min(SCANNED, most))
        }  # fmt: skip

    def __len__(self) -> int:
        return sum(map(len, self._kept.values()))

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
        kept = self._kept[bool(session.start.patient)]
        live = kept.get(session.token, lambda: Live(self._place, session))
        if live.actions != session.actions:  # the session is what counts
            live = Live(self._place, session)
            kept.put(session.token, live)
        return live
