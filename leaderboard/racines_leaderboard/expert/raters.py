"""Raters that are programs: one of known error, to test the kit; the oracle and the grader.

Each answers through the same session as a person does. Its kind stands in every line that it
writes, so that nobody can take it for an expert.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_leaderboard.expert.agreement import round_half_up
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.ratings import Session


@dataclass(frozen=True)
class Simulated:
    """A rater of known error."""

    error_view: float = 0.1
    """Share of images that get another view than the true one, any other with equal chance."""
    grade_sd: float = 1.0
    """Standard deviation of the error of a grade, before it is rounded and cut to 1-10."""
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.error_view <= 1.0:
            raise RacinesError(f"--error-view {self.error_view}: give a share, 0 to 1")
        if not 0.0 <= self.grade_sd < float("inf"):
            raise RacinesError(f"--grade-sd {self.grade_sd}: give 0 or more")

    def answer(
        self, views: np.ndarray, grades: np.ndarray, labels: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Answer (n,) true labels and grades; the last label says that there is no view.

        An image is answered afresh when it is shown again. What is called no view is graded 0.
        """
        rng = np.random.default_rng(self.seed)
        wrong = rng.random(len(views)) < self.error_view
        other = (views + rng.integers(1, labels, len(views))) % labels
        given = np.where(wrong, other, views)
        noise = rng.normal(0.0, self.grade_sd, len(views))
        return given, scale(grades + noise, given, labels)


def scale(grades: np.ndarray, views: np.ndarray, labels: int) -> np.ndarray:
    """Return (n,) grades as a rater gives them: 0 for no view, else whole ones from 1 to 10."""
    return np.where(views == labels - 1, 0.0, round_half_up(grades).clip(1, 10))


def simulate(
    kit: Kit, key: dict[str, Any], rater: Simulated, ratings: Path, name: str | None = None
) -> Session:
    """Let a simulated rater answer what it has not answered yet; return its session."""
    about = f"error_view {rater.error_view:g}, grade_sd {rater.grade_sd:g}, seed {rater.seed}"
    session = Session.open(kit, ratings, name or f"simulated-{rater.seed}", "simulated", about)
    answers = rater.answer(*_known(kit, key, "truth", "the truth"), len(kit.labels))
    return _rate(session, *answers)


def oracle(kit: Kit, key: dict[str, Any], ratings: Path) -> Session:
    """Let the phantom's truth of the pose answer; RacinesError if the images are others."""
    if key["truth"] != "oracle":
        source = key["dataset"]["source"]
        raise RacinesError(f"the kit's dataset is {source}: only the phantom has an oracle")
    return _program(kit, key, ratings, "oracle", "truth", "truth of the pose that was drawn")


def grader(kit: Kit, key: dict[str, Any], ratings: Path) -> Session:
    """Let the grader answer as it judged when the kit was made; RacinesError without one."""
    return _program(kit, key, ratings, "grader", "grader", str((key["grader"] or {}).get("id")))


def _program(
    kit: Kit, key: dict[str, Any], ratings: Path, kind: str, column: str, about: str
) -> Session:
    views, grades = _known(kit, key, column, f"the {kind}")
    session = Session.open(kit, ratings, kind, kind, about)
    return _rate(session, views, scale(grades, views, len(kit.labels)))


def _known(kit: Kit, key: dict[str, Any], column: str, who: str) -> tuple[np.ndarray, np.ndarray]:
    known = [key["images"][image][column] for image in kit.images]
    for image, answer in zip(kit.images, known, strict=True):
        if answer is None or answer["grade"] is None:
            raise RacinesError(f"{kit.folder}: {who} has no view and grade of image {image}")
    views = [kit.labels.index(answer["view"]) for answer in known]
    return np.array(views), np.array([answer["grade"] for answer in known], np.float64)


def _rate(session: Session, views: np.ndarray, grades: np.ndarray) -> Session:
    row = {image: i for i, image in enumerate(session.kit.images)}
    while (image := session.next_image()) is not None:
        session.save(image, session.kit.labels[views[row[image]]], int(grades[row[image]]))
    return session
