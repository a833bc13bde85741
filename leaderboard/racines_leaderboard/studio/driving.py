"""Driving the probe by hand: whose episode it is, and the live environment behind it.

A visitor's state is `Session`, plain values. The environment that stands where its actions lead is
kept on the server under the session's token; one that was given up is made again by replaying the
actions, since an episode follows from its start and actions alone.
"""

import secrets
import threading
from dataclasses import dataclass, replace
from typing import Any

from racines_leaderboard.studio import inputs
from racines_leaderboard.studio.parts import load_grader, load_phantom
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.scene import Curve, Scene, snapshot, take_scene
from racines_leaderboard.studio.shared import Shared

FIXED, SEEDED = "evaluation", "seed"
KINDS = (FIXED, SEEDED)
"""How a start is named: by its number among the fixed starts of evaluations, or by a seed."""
FIXED_STARTS = 100
GREATEST_SEED = 2**31 - 1


@dataclass(frozen=True)
class Session:
    """One visitor's episode."""

    token: str
    """Drawn at random: nobody meets another's environment."""
    task: str
    kind: str
    number: int
    actions: tuple[int, ...] = ()


def begin(task: Any, kind: Any, number: Any) -> Session:
    """Return a session at its start, of values as a browser sent them.

    Raises:
        RacinesError: a task or kind that was not offered, or a number out of range.
    """
    from racines_envs.task.tasks import TASKS

    task, kind = inputs.choice(task, tuple(TASKS), "task"), inputs.choice(kind, KINDS, "start")
    greatest = FIXED_STARTS - 1 if kind == FIXED else GREATEST_SEED
    number = inputs.whole(number, 0, greatest, "number of the start")
    return Session(secrets.token_urlsafe(16), task, kind, number)


def reset_seed(kind: str, number: int) -> Any:
    """Return what a core of one row is reset with for a start."""
    from racines_envs.task.starts import evaluation_seeds

    return evaluation_seeds(number + 1)[-1:] if kind == FIXED else number


class Live:
    """One environment that somebody drives, with what the grader says of each image."""

    def __init__(self, place: Place, session: Session) -> None:
        """Make it, and take the session's actions."""
        from racines_envs.apis.rendering import History, view_names
        from racines_envs.task.tasks import TASKS
        from racines_envs.worlds.making import make_core

        task = TASKS[session.task]
        self.lock = threading.Lock()
        self.core = make_core(
            task,
            observation="image",
            reward="oracle",
            phantom=load_phantom(place, task.anatomy),
            device=place.device,
        )
        self._grader = load_grader(place, view_names(self.core))
        self._history = History(1)
        self._taken: list[int] = []
        self._images: list[Any] = []
        self._judged: list[tuple[float, float]] = []
        self.core.reset(reset_seed(session.kind, session.number))
        self._note(None)
        for action in session.actions:
            self.step(action)

    @property
    def actions(self) -> tuple[int, ...]:
        """What was done since the start."""
        return tuple(self._taken)

    @property
    def done(self) -> bool:
        """Whether the episode is over."""
        return bool(self.core.state.done[0])

    def step(self, action: int) -> None:
        """Take one of the 13 actions; nothing happens once the episode is over."""
        import torch

        if not self.done:
            chosen = torch.tensor([action], device=self.core.device)
            self.core.step(chosen)
            self._taken.append(action)
            self._note(chosen)

    def scene(self, truth: bool) -> Scene:
        """Return the present moment; without `truth` the grader's word alone, if there is one."""
        self._judge()
        curves = []
        if self._grader is not None:
            curves.append(Curve("grader", *zip(*self._judged, strict=True)))
        steps = self._history[0]
        if truth:
            curves.append(Curve("truth", tuple(steps.probabilities), tuple(steps.grades)))
        return take_scene(self.core, snapshot(self.core), steps, curves, truth)

    def _note(self, action: Any) -> None:
        self._history.note(self.core, action)
        self._images.append(self.core.picture()[0])

    def _judge(self) -> None:
        """Let the grader look at the images since it last did, all at once."""
        import torch

        if self._grader is not None and self._images:
            p, grade = self._grader.probabilities_and_grade(torch.stack(self._images))
            judgement = p[:, self.core.task.target].tolist(), grade.tolist()
            self._judged.extend(zip(*judgement, strict=True))
        self._images.clear()


class Lives:
    """The live environments of all visitors, as many as are kept."""

    def __init__(self, place: Place) -> None:
        """Keep at most `place.max_sessions`."""
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
