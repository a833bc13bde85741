"""Scoring a study: answers against the key, by system and overall, and raters with each other."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_leaderboard.expert.agreement import Answers, agreement, fleiss_metric
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.ratings import Ratings
from racines_leaderboard.records.experts import EXPERT, OVERALL, TRUE_FRAMES
from racines_models.provenance import code_version

REMARKS = {
    EXPERT: "Rated by people who say that they are experts; names are pseudonyms.",
    "trial": "Rated by somebody who tried the kit out: not an expert's opinion.",
    "simulated": "Answers drawn by a program with a known error: no expert saw these images.",
    "oracle": "The phantom's own truth in the rater's place: no expert saw these images.",
    "grader": "The grader network in the rater's place: no expert saw these images.",
}
NOTES = [
    "Agreement has Wilson's interval over images; settings.by_trajectory holds the interval of a "
    "bootstrap by trajectory, which is wider where images of one sweep err alike.",
    "Of an image that is shown twice the first name is scored; both tell of the rater alone.",
    "The overall figures are of the generators' images, without the dataset's own frames.",
]


def score(
    kit: Kit, key: dict[str, Any], everyone: Sequence[Ratings], resamples: int = 1000
) -> dict[str, Any]:
    """Return the report of a study, as its schema `expert-scores` has it.

    The key is that of the kit, and everyone a rater of one kind (`ratings.read_all`).

    Raises:
        RacinesError: nothing to compare with but the rater's own opinion.
    """
    kind = everyone[0].kind
    study = _Study(kit, key, kind, resamples)
    told = [[ratings.answers.get(image) for image in kit.images] for ratings in everyone]
    given = [_answers(kit, [each and vars(each) for each in own]) for own in told]
    together = Answers(np.stack([o.views for o in given]), np.stack([o.grades for o in given]))
    return {
        "schema": "racines.expert-scores/1",
        "kind": kind,
        "remark": REMARKS[kind],
        "kit": {"digest": kit.digest, "labels": list(kit.labels)} | key["study"],
        "dataset": key["dataset"],
        "truth": key["truth"],
        "systems": {
            name: {"weights": key["systems"].get(name, {}).get("weights")} | agreement
            for name, agreement in study.systems(together).items()
        },
        "grader": key["grader"],
        "raters": [
            _described(ratings)
            | {"systems": study.systems(own.alone()), "repeats": study.repeats(own)}
            for ratings, own in zip(everyone, given, strict=True)
        ],
        "between": study.between([ratings.rater for ratings in everyone], together),
        "code": code_version(),
        "notes": NOTES,
    }


class _Study:
    """The key as arrays over the N entries of a kit, in the order of their names."""

    def __init__(self, kit: Kit, key: dict[str, Any], kind: str, resamples: int) -> None:
        self.labels, self.resamples = len(kit.labels), resamples
        table = [key["images"][image] for image in kit.images]
        sources = {key["truth"]: "truth", "grader": "grader"}
        told = {n: _answers(kit, [e[column] for e in table]) for n, column in sources.items()}
        self.references = {n: one for n, one in told.items() if n != kind and one.views.max() >= 0}
        """(N,) answers each; never the rater's own."""
        if not self.references:
            raise RacinesError(
                f"the kit holds no opinion but that of the {kind} itself: make it with --grader"
            )
        self.systems_of = np.array([entry["system"] for entry in table])
        """(N,) name of the maker of each."""
        trajectories = [entry["trajectory"] for entry in table]
        self.trajectories = np.unique(trajectories, return_inverse=True)[1]
        """(N,) integers."""
        row = {image: i for i, image in enumerate(kit.images)}
        pairs = [(row[e["repeat_of"]], i) for i, e in enumerate(table) if e["repeat_of"]]
        self.twins = np.array(pairs, np.int64).reshape(-1, 2)
        """(P, 2) entries that show one image: that of the first name, that of the second."""
        self.firsts = np.setdiff1d(np.arange(len(table)), self.twins[:, 1])
        """Entries without the second ones of an image."""

    def compare(self, given: Answers, reference: Answers, rows: np.ndarray) -> dict[str, Any]:
        """Compare (R, n) answers with (n,) answers to the entries `rows`."""
        return agreement(given, reference, self.trajectories[rows], self.labels, self.resamples)

    def systems(self, given: Answers) -> dict[str, Any]:
        """Compare (R, N) answers with each reference, overall and by system."""
        firsts = self.firsts
        names = self.systems_of[firsts]
        generated = firsts[names != TRUE_FRAMES]
        groups = {OVERALL: generated if len(generated) else firsts}
        groups |= {str(name): firsts[names == name] for name in np.unique(names)}
        systems = {}
        for system, rows in groups.items():
            own, references = given.of(rows), self.references.items()
            told = {name: self.compare(own, one.of(rows), rows) for name, one in references}
            systems[system] = {"references": told}
        return systems

    def repeats(self, own: Answers) -> dict[str, Any] | None:
        """Compare a rater's (N,) answers to images shown twice: the second name, the first."""
        if not len(self.twins):
            return None
        first, second = self.twins.T
        return self.compare(own.of(second).alone(), own.of(first), first)

    def between(self, names: Sequence[str], given: Answers) -> dict[str, Any] | None:
        """Compare R raters' (R, N) answers pair by pair, and all at once by Fleiss' kappa."""
        if len(names) < 2:
            return None
        rows = self.firsts
        own = [Answers(*pair).of(rows) for pair in zip(given.views, given.grades, strict=True)]
        pairs = [
            {"raters": [names[a], names[b]]} | self.compare(own[b].alone(), own[a], rows)
            for a, b in combinations(range(len(names)), 2)
        ]
        places = self.trajectories[rows]
        fleiss = fleiss_metric(given.of(rows).views, places, self.labels, self.resamples)
        return {"pairs": pairs, "fleiss_kappa": fleiss}


def _answers(kit: Kit, opinions: Sequence[dict[str, Any] | None]) -> Answers:
    """Return the (N,) answers of one who told view and grade of each entry, or nothing."""
    known = [each or {"view": None, "grade": None} for each in opinions]
    views = [-1 if a["view"] is None else kit.labels.index(a["view"]) for a in known]
    grades = [np.nan if a["grade"] is None else a["grade"] for a in known]
    return Answers(np.array(views, np.int64), np.array(grades, np.float64))


def _described(ratings: Ratings) -> dict[str, Any]:
    times = [a.seconds for a in ratings.answers.values() if a.seconds is not None]
    return {
        "rater": ratings.rater,
        "kind": ratings.kind,
        "about": ratings.about,
        "answered": len(ratings.answers),
        "median_seconds": round(float(np.median(times)), 3) if times else None,
    }
