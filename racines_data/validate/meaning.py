"""Checks of what the rows mean: views and grades, and the distribution of the twelve parameters.

Views and grades are held against one another, a grader's and the oracle's, which judges a sample of
simulated frames again, from their measured poses. The statistics of the parameters are held against
the paper's table.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.phantom import PHANTOM_VERSION, Phantom, PhantomConfig
from racines_data.phantom.config import heart_config, phantom_settings
from racines_data.schema import PARAMETERS
from racines_data.sources.gate.labels import label_fault
from racines_data.validate.survey import Survey
from racines_data.views import PAPER_STATISTICS, RANDOM, ParameterStatistics

SAMPLE = 2048  # frames judged again, at even distances over the whole config
HEARTS = 3  # hearts of `multi_phantom` judged again: each has to be made first, which takes seconds
VIEW_AGREEMENT = 0.97
"""Least share of equal views. The recorded pose has the sensor's noise, the recorded label is of
the true pose: frames at the edge of a view may fall to either side."""
GRADE_ERROR = 0.3  # largest median difference of grades, of frames with the same view

MEAN_LIMIT = 0.25  # largest difference of means, in standard deviations of the paper
STD_RATIO = (0.75, 1.33)  # smallest and largest ratio of standard deviations
RANGE_LIMIT = 0.10  # how far a value may lie beyond the paper's range, as a share of its width
FULL_SIZE = 100_000  # frames from which the table has to hold; fewer are a rough sample of it
MODE_WIDTH = math.pi / 4  # distance from ±π, rad, within which a frame is of a mode of rotation_x
MODE_SHARE = 0.20  # least share of frames in each mode
BETWEEN_SHARE = 0.01  # largest share with |rotation_x| < π/2, where the probe would look up


def check_labels(survey: Survey, labels: tuple[str, ...]) -> str:
    """Check that targets are labels, and that only a known view is graded, by 1-10."""
    odd = sorted({sweep.target_view for sweep in survey.sweeps} - set(labels))
    if odd:
        raise RacinesError(f"target view {odd[0]!r} is none of {', '.join(labels)}")
    for sweep in survey.sweeps:
        if fault := label_fault(sweep.views, sweep.grades, labels):
            row, what = fault
            raise RacinesError(f"trajectory {sweep.id}: frame {row} is {what}")
    views, grades = survey.column("views"), survey.column("grades")
    if not (views >= 0).any():
        return "no frame has a view or a grade"
    return (
        f"{(views >= 0).mean():.1%} of the frames have a view, "
        f"{(~np.isnan(grades)).mean():.1%} a grade"
    )


def view_shares(survey: Survey, labels: tuple[str, ...]) -> dict[str, Any]:
    """Return the share of frames of each view, and, by target, the share that show the target."""
    views, target = survey.column("views"), survey.each("target_view")
    known = views >= 0
    if not known.any():
        return {"frames": {}, "on_target": {}}
    shares = np.bincount(views[known], minlength=len(labels)) / known.sum()
    aimed = {label: views[known & (target == label)] for label in labels}
    return {
        "frames": dict(zip(labels, shares.tolist(), strict=True)),
        "on_target": {
            label: float((aimed[label] == index).mean())
            for index, label in enumerate(labels)
            if len(aimed[label])
        },
    }


def check_views(shares: dict[str, Any]) -> str:
    """Check that sweeps to a view show it now and then."""
    if not shares["on_target"]:
        return "no frame of a targeted sweep has a view"
    lost = [view for view, share in shares["on_target"].items() if view != RANDOM and not share]
    if lost:
        raise RacinesError(f"no sweep to {', '.join(lost)} ever shows it")
    parts = [f"{view} {share:.0%}" for view, share in shares["on_target"].items()]
    return f"frames that show what their sweep aims at: {', '.join(parts)}"


def check_annotation(survey: Survey, manifest: dict[str, Any], labels: tuple[str, ...]) -> str:
    """Check that all frames have a grader's view and grade, or none has."""
    view, grade = survey.column("predicted").T
    present = ~np.isnan(view)
    if not np.array_equal(present, ~np.isnan(grade)):
        raise RacinesError("view_predicted and grade_predicted are not there together")
    annotation = manifest.get("annotation") if survey.config == "frames" else None
    if not annotation:
        if present.any():
            raise RacinesError(f"{present.sum()} frames are annotated, by no recorded grader")
        return "not annotated"
    if not present.all():
        raise RacinesError(f"annotated, yet {(~present).sum()} frames lack the grader's opinion")
    if ((view < 0) | (view >= len(labels)) | (grade < 0) | (grade > 10)).any():
        raise RacinesError("view_predicted is no label, or grade_predicted lies outside 0-10")
    return f"every frame, by grader {annotation['grader'][:16]}"


@dataclass(frozen=True)
class Rejudged:
    """How the labels of a dataset agree with what the oracle says of its poses."""

    n: int
    view_agreement: float
    grade_error: float | None  # median absolute difference over frames of the same view, if any


def rejudge(survey: Survey, manifest: Mapping[str, Any]) -> Rejudged | str:
    """Judge a sample of poses with the oracle that the recipe names; or say why there is none."""
    settings = phantom_settings(manifest, survey.config)
    if settings is None:
        return "the source has no oracle"
    if settings["version"] != PHANTOM_VERSION:
        return f"labels of phantom {settings['version']}; the oracle here is {PHANTOM_VERSION}"
    base = fill(PhantomConfig, settings["phantom"], "recipe: phantom")
    rows, seeds = _sample(survey)
    views, grades = survey.column("views")[rows], survey.column("grades")[rows]
    parameters = torch.from_numpy(survey.column("parameters")[rows])
    judged_view, judged_grade = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
    for seed in np.unique(seeds):
        chosen = np.flatnonzero(seeds == seed)
        config = base if seed == base.anatomy_seed else heart_config(base, int(seed))
        truth = Phantom(config).truth(parameters[torch.from_numpy(chosen)])
        judged_view[chosen], judged_grade[chosen] = truth.view.numpy(), truth.grade.numpy()
    same = judged_view == views
    of_view = same & (grades > 0)
    error = float(np.median(np.abs(judged_grade - grades)[of_view])) if of_view.any() else None
    return Rejudged(len(rows), float(same.mean()), error)


def _sample(survey: Survey) -> tuple[np.ndarray, np.ndarray]:
    """Return rows, evenly spread over at most `HEARTS` seeds of the anatomy, and their seeds."""
    seeds = survey.each("phantom").astype(np.int64)
    known = np.unique(seeds)
    kept = known[np.linspace(0, len(known) - 1, min(HEARTS, len(known))).round().astype(int)]
    rows = np.flatnonzero(np.isin(seeds, kept))
    if len(rows) > SAMPLE:
        rows = rows[(np.arange(SAMPLE) * len(rows) + len(rows) // 2) // SAMPLE]
    return rows, seeds[rows]


def check_rejudged(found: Rejudged | str) -> str:
    """Check the agreement of labels and oracle."""
    if isinstance(found, str):
        return f"not judged again: {found}"
    said = f"{found.view_agreement:.1%} of {found.n} views judged the same again"
    if found.grade_error is not None:
        said += f", grades off by {found.grade_error:.2f} (median)"
    if found.view_agreement < VIEW_AGREEMENT:
        raise RacinesError(f"{said}; {VIEW_AGREEMENT:.0%} are expected")
    if found.grade_error is not None and found.grade_error > GRADE_ERROR:
        raise RacinesError(f"{said}; {GRADE_ERROR} at most is expected")
    return said


@dataclass(frozen=True)
class Verdict:
    """One parameter beside the paper's row."""

    mean: float  # |mean - paper's|, in standard deviations of the paper
    std: float  # ratio of the standard deviations
    beyond: float  # how far the extremes lie outside the paper's range, as a share of its width

    @property
    def faults(self) -> list[str]:
        """What does not hold."""
        limits = (
            (self.mean <= MEAN_LIMIT, f"mean off by {self.mean:.2f} std"),
            (STD_RATIO[0] <= self.std <= STD_RATIO[1], f"std x {self.std:.2f}"),
            (self.beyond <= RANGE_LIMIT, f"{100 * self.beyond:.0f} % beyond the range"),
        )
        return [fault for holds, fault in limits if not holds]


def statistics_of(parameters: np.ndarray) -> dict[str, ParameterStatistics]:
    """Return the statistics of the columns of (N, 12) parameters that were measured at all."""
    statistics = {}
    for index, name in enumerate(PARAMETERS):
        values = parameters[:, index].astype(np.float64)
        values = values[~np.isnan(values)]
        if len(values):
            moments = values.min(), values.max(), values.mean(), values.std()
            statistics[name] = ParameterStatistics(*(float(moment) for moment in moments))
    return statistics


def verdicts_of(statistics: dict[str, ParameterStatistics]) -> dict[str, Verdict]:
    """Hold each parameter beside the paper's table."""
    verdicts = {}
    for name, ours in statistics.items():
        paper = PAPER_STATISTICS[name]
        outside = max(paper.minimum - ours.minimum, ours.maximum - paper.maximum, 0.0)
        beyond = outside / (paper.maximum - paper.minimum)
        mean = abs(ours.mean - paper.mean) / paper.std
        verdicts[name] = Verdict(mean, ours.std / paper.std, beyond)
    return verdicts


def has_paper(manifest: dict[str, Any]) -> bool:
    """Return whether the paper's table is the measure of this dataset: the block with a heart."""
    return manifest["source"] == "release" or _simulates_heart(manifest)


def must_meet_paper(manifest: dict[str, Any]) -> bool:
    """Return whether a departure from the paper's table is a fault.

    It is for the simulated heart at full size, which is calibrated to the table. It is not for
    recordings: what was published is what it is, and an import may be of a part of it.
    """
    return _simulates_heart(manifest) and manifest["counts"]["frames"] >= FULL_SIZE


def _simulates_heart(manifest: dict[str, Any]) -> bool:
    if manifest["source"] != "phantom":
        return False
    node: Any = manifest.get("recipe") or {}
    for key in ("settings", "acquisition", "phantom"):
        node = node.get(key) or {}
    return node.get("anatomy", "heart") == "heart"


def check_paper(verdicts: dict[str, Verdict]) -> str:
    """Check that every parameter was measured and holds."""
    faults = [f"{name} was not measured" for name in PARAMETERS if name not in verdicts]
    faults += [f"{name}: {', '.join(v.faults)}" for name, v in verdicts.items() if v.faults]
    if faults:
        held = len(PARAMETERS) - len(faults)
        raise RacinesError(f"{held} of 12 parameters hold; {'; '.join(faults)}")
    furthest = max(verdict.mean for verdict in verdicts.values())
    ratios = [verdict.std for verdict in verdicts.values()]
    return (
        f"12 of 12 parameters hold: means within {furthest:.2f} std, std ratios "
        f"{min(ratios):.2f} to {max(ratios):.2f}"
    )


def check_modes(parameters: np.ndarray) -> str:
    """Check that rotation_x has two modes, at ±π, and next to nothing between them.

    A probe that looks down has rotation_x = ±π, and hand and tremor carry it across the jump.
    """
    angle = parameters[:, PARAMETERS.index("rotation_x")]
    near = np.abs(np.abs(angle) - math.pi) <= MODE_WIDTH
    shares = near & (angle > 0), near & (angle < 0), np.abs(angle) < math.pi / 2
    up, down, between = (float(share.mean()) for share in shares)
    said = f"{100 * up:.1f} % within 45° of +π, {100 * down:.1f} % of -π"
    if min(up, down) < MODE_SHARE:
        raise RacinesError(f"{said}; each mode needs {100 * MODE_SHARE:.0f} %")
    if between > BETWEEN_SHARE:
        raise RacinesError(f"{said}, and {100 * between:.1f} % look upwards")
    return f"{said}, {100 * between:.1f} % between"
