import json

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torchmetrics.functional.classification import multiclass_cohen_kappa

from racines_data.errors import RacinesError
from racines_data.views import LABELS
from racines_leaderboard.expert import raters
from racines_leaderboard.expert.agreement import (
    Answers,
    agreement,
    confusion,
    fleiss_metric,
    kappa,
    kappa_metric,
    nominal,
    quadratic,
)
from racines_leaderboard.expert.ratings import read_all
from racines_leaderboard.expert.score import REMARKS, draw, score, write_picture
from racines_leaderboard.records.schema import check
from tests.leaderboard.expert_kit import Judge, kit_of

RANDOM = len(LABELS) - 1
COHEN = np.array([[44, 7, 9], [5, 20, 5], [1, 3, 6]]) * 2
"""Cohen (1968), 200 patients and two raters."""
FLEISS = (
    "0 0 0 0 14  0 2 6 4 2  0 0 3 5 6  0 3 9 2 0  2 2 8 1 1  "
    "7 7 0 0 0  3 2 6 3 0  2 5 3 2 2  6 5 2 1 0  0 2 2 3 7"
)
"""Ten subjects, five categories, fourteen raters; kappa 0.210."""


def test_kappa_of_a_published_table():
    cost = np.array([[0, 1, 3], [1, 0, 6], [3, 6, 0]])
    assert kappa(COHEN, nominal(3)) == pytest.approx(0.492, abs=5e-4)
    assert kappa(COHEN, cost) == pytest.approx(0.348, abs=5e-4)


@pytest.mark.parametrize(("cost", "weights"), [(nominal(11), None), (quadratic(11), "quadratic")])
def test_kappa_is_that_of_torchmetrics(cost, weights):
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 11, 300)
    given = np.clip(truth + rng.integers(-2, 3, 300), 0, 10)
    counts = confusion(truth, given[None], np.zeros(300, np.int64), 11)[0, 0]
    pair = (torch.from_numpy(given), torch.from_numpy(truth))
    assert kappa(counts, cost) == pytest.approx(float(multiclass_cohen_kappa(*pair, 11, weights)))


def test_kappa_without_any_disagreement_by_chance_has_no_value():
    assert np.isnan(kappa(np.diag([5, 0]), nominal(2)))
    figure = kappa_metric(np.diag([5, 0])[None, None], nominal(2), "k")
    assert figure["value"] is None and figure["n"] == 5


def test_fleiss_kappa_of_a_published_table():
    table = np.array(FLEISS.split(), int).reshape(10, 5)
    views = np.stack([np.repeat(np.arange(5), row) for row in table], 1)
    assert views.shape == (14, 10)
    figure = fleiss_metric(views, np.arange(10), 5, 50)
    assert figure["value"] == pytest.approx(0.210, abs=5e-4)
    assert figure["low"] < figure["value"] < figure["high"] and figure["n"] == 10
    assert "jackknife" in figure["settings"]["interval"], "ten subjects are few"


def test_figures_of_answers_counted_by_hand():
    reference = Answers(np.array([0, 1, RANDOM, 2, -1]), np.array([7.4, 3.0, 0.0, 5.0, np.nan]))
    given = Answers(np.array([[0, 2, RANDOM, RANDOM, 1]]), np.array([[8.0, 5.0, 0.0, 0.0, 4.0]]))
    told = agreement(given, reference, np.arange(5), len(LABELS), 50)
    values = {name: (metric["value"], metric["n"]) for name, metric in told["metrics"].items()}
    assert values["view_agreement"] == (0.5, 4)
    assert values["grade_agreement"] == (0.5, 4), "8 and 7.4 agree, 0 and 0 agree"
    assert values["grade_exact"] == (0.25, 4), "7.4 is rounded to 7"
    assert values["grade_difference"] == (pytest.approx((0.6 + 2.0) / 2), 2)
    assert told["confusion"]["views"][2][RANDOM] == 1 and np.sum(told["confusion"]["views"]) == 4
    assert told["confusion"]["grades"][7][8] == 1


def test_several_raters_count_each_image_once():
    reference = Answers(np.array([0, 1, 2, 3]), np.full(4, 5.0))
    given = Answers(np.array([[0, 1, 2, 0], [0, 0, -1, 3]]), np.full((2, 4), 5.0))
    metric = agreement(given, reference, np.arange(4), len(LABELS), 50)["metrics"]["view_agreement"]
    assert metric["n"] == 4 and metric["value"] == pytest.approx((1 + 0.5 + 1 + 0.5) / 4)


def expected_grade_agreement(
    rater: raters.Simulated, views: np.ndarray, grades: np.ndarray
) -> float:
    """The chance that a simulated grade differs by at most one, over images, by its definition."""
    whole = np.arange(1, 11)
    edges = np.array([-np.inf, *(whole[1:] - 0.5), np.inf])
    below = norm.cdf((edges - grades[:, None]) / rater.grade_sd)
    close = np.abs(whole - grades[:, None]) <= 1.0
    graded = (np.diff(below, axis=1) * close).sum(1)
    other = rater.error_view / (len(LABELS) - 1)
    none = np.where(views == RANDOM, 1.0 - rater.error_view, other)
    return float((none * (grades <= 1.0) + (1.0 - none) * graded).mean())


def expected_kappa(rater: raters.Simulated, views: np.ndarray) -> float:
    size = len(LABELS)
    share = np.full((size, size), rater.error_view / (size - 1))
    np.fill_diagonal(share, 1.0 - rater.error_view)
    return float(kappa(np.bincount(views, minlength=size)[:, None] * share, nominal(size)))


@pytest.mark.parametrize(
    ("error", "sd"), [(0.1, 1.0), pytest.param(0.35, 2.5, marks=pytest.mark.thorough)]
)
def test_intervals_hold_the_known_error_of_a_simulated_rater(error, sd):
    """Of 200 simulated raters about 95 % have intervals that hold the truth."""
    rng = np.random.default_rng(1)
    views = rng.integers(0, len(LABELS), 400)
    grades = np.where(views == RANDOM, 0.0, rng.uniform(1.0, 10.0, 400))
    reference, places = Answers(views, grades), np.arange(400) % 80
    rater = raters.Simulated(error, sd)
    truth = {
        "view_agreement": 1.0 - error,
        "grade_agreement": expected_grade_agreement(rater, views, grades),
        "view_kappa": expected_kappa(rater, views),
        "again": (1.0 - error) ** 2 + error**2 / (len(LABELS) - 1),
    }
    held = dict.fromkeys(truth, 0)
    mean = dict.fromkeys(truth, 0.0)
    for seed in range(200):
        first, second = (
            Answers(*raters.Simulated(error, sd, one).answer(views, grades, len(LABELS)))
            for one in (seed, seed + 200)
        )
        metrics = agreement(first.alone(), reference, places, len(LABELS), 300)["metrics"]
        twice = agreement(second.alone(), first, places, len(LABELS), 2)["metrics"]
        metrics["again"] = twice["view_agreement"]
        for name, value in truth.items():
            held[name] += metrics[name]["low"] <= value <= metrics[name]["high"]
            mean[name] += metrics[name]["value"] / 200
    assert mean == pytest.approx(truth, abs=0.005)
    # 95 % of 200 is 190 ± 3; a percentile bootstrap holds a little less than it says.
    assert all(176 <= count <= 199 for count in held.values()), held


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    return kit_of(tmp_path_factory.mktemp("study"), grader=Judge(), images=200, repeats=60)


@pytest.fixture(scope="module")
def report(kit, tmp_path_factory):
    """Two simulated raters of known error, end to end."""
    folder = tmp_path_factory.mktemp("ratings")
    key = kit.read_key()
    paths = [
        raters.simulate(kit, key, raters.Simulated(0.1, 1.0, seed), folder).path for seed in (0, 1)
    ]
    return score(kit, key, read_all(paths, kit), 200)


def holds(metric, value):
    return metric["low"] <= value <= metric["high"]


def test_a_study_end_to_end_recovers_a_simulated_raters_error(kit, report):
    check(report, "expert-scores", "report")
    assert report["kind"] == "simulated" and "no expert" in report["remark"]
    assert set(report["systems"]) == {"overall", "inverse", "true-frames"}
    for system, n in (("overall", 100), ("inverse", 100), ("true-frames", 100)):
        metrics = report["systems"][system]["references"]["oracle"]["metrics"]
        assert metrics["view_agreement"]["n"] == n
        assert holds(metrics["view_agreement"], 0.9)
    again = 0.9**2 + 0.1**2 / (len(LABELS) - 1)
    for rater in report["raters"]:
        assert rater["about"].startswith("error_view 0.1, grade_sd 1, seed")
        assert rater["answered"] == 260 and rater["kind"] == "simulated"
        assert rater["repeats"]["metrics"]["view_agreement"]["n"] == 60
        found = rater["repeats"]["metrics"]["view_agreement"]["value"]
        assert found == pytest.approx(again, abs=4 * (again * (1 - again) / 60) ** 0.5)
    (pair,) = report["between"]["pairs"]
    assert pair["raters"] == ["simulated-0", "simulated-1"]
    assert pair["metrics"]["view_agreement"]["n"] == 200, "repeats are not counted twice"
    assert holds(pair["metrics"]["view_agreement"], again)
    # For two raters, Fleiss' kappa is near Cohen's: the same with the margins pooled.
    cohen = pair["metrics"]["view_kappa"]["value"]
    assert report["between"]["fleiss_kappa"]["value"] == pytest.approx(cohen, abs=0.01)


def test_a_program_is_never_compared_with_itself(kit, tmp_path):
    key = kit.read_key()
    for answer, other, kind in (
        (raters.oracle, "grader", "oracle"),
        (raters.grader, "oracle", "grader"),
    ):
        session = answer(kit, key, tmp_path)
        told = score(kit, key, read_all([session.path], kit), 20)
        check(told, "expert-scores", "report")
        assert told["kind"] == kind and told["remark"] == REMARKS[kind]
        assert list(told["systems"]["overall"]["references"]) == [other]
    counts = np.array(told["systems"]["overall"]["references"]["oracle"]["confusion"]["views"])
    assert counts[:, [1, RANDOM]].sum() == counts.sum() == 100, "the grader says SC or nothing"
    bare = kit_of(tmp_path, images=20, repeats=0)
    session = raters.oracle(bare, bare.read_key(), tmp_path / "bare")
    with pytest.raises(RacinesError, match="--grader"):
        score(bare, bare.read_key(), read_all([session.path], bare), 20)
    with pytest.raises(RacinesError, match="the grader has no view"):
        raters.grader(bare, bare.read_key(), tmp_path / "bare")


def test_an_unfinished_rater_counts_what_was_rated(kit, tmp_path):
    key = kit.read_key()
    path = raters.simulate(kit, key, raters.Simulated(0.0, 0.0), tmp_path).path
    lines = path.read_text().splitlines()[:100]
    path.write_text("\n".join(lines) + "\n")
    told = score(kit, key, read_all([path], kit, partial=True), 20)
    systems = told["systems"]
    ns = [systems[s]["references"]["oracle"]["metrics"]["view_agreement"] for s in systems]
    firsts = [json.loads(line)["image"] for line in lines]
    expected = sum(key["images"][image]["repeat_of"] is None for image in firsts)
    assert ns[1]["n"] + ns[2]["n"] == expected < 100
    assert {metric["value"] for metric in ns} == {1.0}, "no error, full agreement"


@pytest.mark.parametrize("change", [{"error_view": 1.5}, {"grade_sd": -1.0}])
def test_errors_that_cannot_be_are_refused(change):
    with pytest.raises(RacinesError, match="--"):
        raters.Simulated(**change)


def test_the_picture_names_who_rated(report, tmp_path):
    write_picture(tmp_path / "report.png", report)
    first = (tmp_path / "report.png").read_bytes()
    write_picture(tmp_path / "report.png", report)
    assert (tmp_path / "report.png").read_bytes() == first
    figure = draw(report)
    assert "no expert" in figure.get_suptitle()
    assert len(figure.axes) == 6, "two references, three panels each"
