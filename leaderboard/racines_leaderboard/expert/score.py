"""Scoring a study: answers against the key, by system and overall, and raters with each other.

The report is JSON, tables for a terminal, and a picture of confusion and agreement.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.plotting import INK, MUTED, OURS, PAPER, SHARES, SMALL, card_style, encode
from racines_data.tables import console_table
from racines_data.terminal import shown_text
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
COLUMNS = {
    "view_agreement": ("view (%)", 100.0, 1),
    "view_kappa": ("view κ", 1.0, 3),
    "grade_agreement": ("grade ± 1 (%)", 100.0, 1),
    "grade_exact": ("grade = (%)", 100.0, 1),
    "grade_kappa": ("grade κ, quadratic", 1.0, 3),
    "grade_difference": ("grade difference", 1.0, 2),
}
TITLES = {"oracle": "the oracle", "labels": "the dataset's labels", "grader": "the grader"}
RATERS = {"expert": "expert", "trial": "trial", "simulated": "simulated rater"}
BARS = (("view_agreement", "view", OURS, -0.13), ("grade_agreement", "grade ± 1", PAPER, 0.13))


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


def show(report: dict[str, Any], console: Console) -> None:
    """Print a report."""
    raters, between = report["raters"], report["between"]
    everyone = f"{report['kind']} ({', '.join(each['rater'] for each in raters)})"
    systems = [
        (name, reference, found["metrics"])
        for name, system in report["systems"].items()
        for reference, found in system["references"].items()
    ]
    again = [(r["rater"], "itself", r["repeats"]["metrics"]) for r in raters if r["repeats"]]
    pairs = [(*pair["raters"], pair["metrics"]) for pair in between["pairs"]] if between else []
    for title, first, rows in (
        (everyone, "system", systems),
        ("images shown twice", "rater", again),
        ("raters with each other", "rater", pairs),
    ):
        lines = []
        for *names, metrics in rows:
            cells = [_cell(metrics[key], scale, n) for key, (_, scale, n) in COLUMNS.items()]
            lines.append((*names, *cells, str(metrics["view_agreement"]["n"])))
        if lines:
            head = (first, "against", *(name for name, *_ in COLUMNS.values()), "n")
            console.print(console_table(head, lines, title, right=2))
    if between:
        fleiss = between["fleiss_kappa"]
        told = f"Fleiss' κ of the views: {_cell(fleiss, 1.0, 3)}, n = {fleiss['n']}"
        console.print(shown_text(told))
    remark = shown_text(f"Lines below a figure: 95 % interval. {report['remark']}")
    console.print(remark, style="dim")


def _cell(metric: dict[str, Any], scale: float, digits: int) -> str:
    value, low, high = (
        None if metric[key] is None else f"{scale * metric[key]:.{digits}f}"
        for key in ("value", "low", "high")
    )
    if value is None:
        return "–"
    return value if low is None else f"{value}\n{low}–{high}"


def write_picture(path: Path, report: dict[str, Any]) -> None:
    """Draw a report as PNG: one row a reference."""
    with card_style():
        write_atomic(path, encode(draw(report)))


def draw(report: dict[str, Any]) -> Figure:
    """Return the figure; see `write_picture`."""
    references = report["systems"][OVERALL]["references"]
    figure = Figure(figsize=(12.5, 0.6 + 3.9 * len(references)), layout="constrained")
    rows = figure.subplots(len(references), 3, squeeze=False, width_ratios=(1.0, 1.25, 1.0))
    rater = RATERS.get(report["kind"], f"{report['kind']} as rater")
    for (left, middle, right), (name, found) in zip(rows, references.items(), strict=True):
        labels, reference = report["kit"]["labels"], TITLES[name]
        _matrix(left, found["confusion"]["views"], labels, f"Views, {OVERALL}", True)
        grades = found["confusion"]["grades"]
        _matrix(middle, grades, [*map(str, range(len(grades)))], f"Grades, {OVERALL}", False)
        for axes in (left, middle):
            axes.set_xlabel(rater)
            axes.set_ylabel(reference)
        of_systems = report["systems"].items()
        _systems(right, {key: each["references"][name]["metrics"] for key, each in of_systems})
        right.set_title(f"Agreement with {reference}")
    figure.suptitle(f"{len(report['raters'])} × {rater}. {report['remark']}", size=9.5)
    return figure


def _matrix(axes: Axes, counts: Any, names: list[str], title: str, shares: bool) -> None:
    counts = np.array(counts)
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    axes.imshow(share**0.5, cmap=SHARES, vmin=0.0, vmax=1.1, aspect="auto")
    axes.grid(False)
    for row, column in np.argwhere(counts):
        part = f"\n{100 * share[row, column]:.0f} %" if shares else ""
        style = {"color": "white" if share[row, column] > 0.4 else INK, "fontsize": SMALL}
        text = f"{counts[row, column]:,}{part}"
        axes.text(column, row, text, ha="center", va="center", **style)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_title(title)


def _systems(axes: Axes, systems: dict[str, dict[str, Any]]) -> None:
    """Draw the agreement of systems, by name, with one reference."""
    for key, label, colour, shift in BARS:
        for row, metrics in enumerate(systems.values()):
            metric, y = metrics[key], row + shift
            if metric["value"] is None:
                continue
            ends = [100 * metric["low"], 100 * metric["high"]]
            axes.plot(ends, [y, y], color=colour, alpha=0.45, linewidth=4, solid_capstyle="butt")
            shown = label if row == 0 else None
            axes.plot([100 * metric["value"]], [y], "o", color=colour, markersize=5, label=shown)
    counted = [f"{name}\nn = {each['view_agreement']['n']}" for name, each in systems.items()]
    axes.set_yticks(range(len(systems)), counted)
    axes.set_ylim(len(systems) - 0.4, -0.6)
    axes.set_xlim(0, 102)
    axes.set_xlabel("% of images, Wilson 95 %")
    axes.tick_params(axis="y", labelcolor=MUTED)
    axes.legend(loc="best")
