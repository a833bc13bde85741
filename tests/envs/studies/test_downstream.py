"""What servos learn from images: who draws, that all else is equal, correlations, going on."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from scipy.stats import spearmanr

from racines_data.config import fill, read_params
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose, pose_to_parameters
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient
from racines_data.patients.scouts import scout
from racines_data.randomness import derive
from racines_envs.agents.servo.frames import STREAM, draw_frames, places_of
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.studies.downstream.config import METRICS, Anchors, DownstreamConfig, LessonConfig
from racines_envs.studies.downstream.correlation import BOARD, SCORE, add_scores, correlations
from racines_envs.studies.downstream.lessons import examined, lesson, taught
from racines_envs.studies.downstream.points import (
    Drawn,
    Mean,
    Truth,
    blurred,
    open_point,
    open_points,
    strayed,
)
from racines_envs.studies.downstream.run import measure_points, point_file
from tests.conftest import ROOT

PATIENT, SMALL = 1, LessonConfig(frames=24, places=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("lessons")


@pytest.fixture(scope="module")
def learned(folder):
    return lesson(PATIENT, SMALL, folder)


@pytest.fixture(scope="module")
def whom(learned):
    places = places_of(PATIENT, SMALL.places)
    return examined(PATIENT, places, learned.scouts, learned.swept)


def draw(point, whom, learned):
    return point.draw(whom, learned.rows, learned.parameters, learned.seeds)


def test_the_truth_teaches_what_a_servo_is_taught_of_still_hearts(learned):
    pool = Pool(places_of(PATIENT, SMALL.places))
    seeds = derive(torch.full((SMALL.frames,), STREAM), PATIENT, torch.arange(SMALL.frames))
    own = draw_frames(pool, torch.arange(SMALL.frames) % 2, seeds, SMALL.servo)
    found = taught(open_point("truth"), PATIENT, learned)
    for name in ("ways", "scores", "grades"):
        assert torch.equal(getattr(own, name), getattr(found, name)), name
    # Poses are handed on as float32 parameters, and speckle is another draw.
    apart = (own.images.int() - found.images.int()).abs().float()
    assert len(own.images) == len(found.images) and apart.mean() < 4.0


def test_a_lesson_is_read_back_as_it_was_made(folder, learned, monkeypatch):
    monkeypatch.setattr("racines_envs.studies.downstream.lessons._made", None)
    again = lesson(PATIENT, SMALL, folder)
    assert all(torch.equal(*pair) for pair in zip(learned, again, strict=True))
    pool = Pool(places_of(PATIENT, 1))
    assert torch.equal(scout(pool, SMALL.seed, masks=False).images[0], learned.scouts[0])


def test_somebody_else_lies_in_the_same_place(whom):
    for own, other in zip(whom.patients, whom.others, strict=True):
        assert other.place == own.place and other.examination == own.examination
        assert other.form == draw_patient(2).form != own.form


def test_the_truth_is_made_worse_in_steps(whom, learned):
    truth = draw(Truth("", "truth"), whom, learned).float()
    for name, amounts in {"blur": (1, 4), "stray": (2, 8), "wrong": (0.3, 1.0)}.items():
        worse = [draw(Truth("", "", **{name: each}), whom, learned).float() for each in amounts]
        missed = [(each - truth).square().mean() for each in worse]
        assert 0 < missed[0] < missed[1], name
    all_wrong = draw(Truth("", "", wrong=1.0), whom, learned)
    pose = parameters_to_pose(learned.parameters.double())
    seeds = derive(learned.seeds, 977)
    assert torch.equal(all_wrong, Pool(whom.others).render(pose, learned.rows, seeds=seeds))


def test_a_row_depends_on_its_own_seed_alone(whom, learned):
    point = Truth("", "", blur=2.0, stray=4.0, wrong=0.5)
    every, few = draw(point, whom, learned), torch.tensor([3, 11])
    alone = point.draw(
        whom, *(each[few] for each in (learned.rows, learned.parameters, learned.seeds))
    )
    assert torch.equal(every[few], alone)


def test_strayed_poses_lie_about_the_told_ones():
    told = parameters_to_pose(torch.zeros(4000, 12).double() + _upright())
    pose = strayed(told, derive(torch.zeros(4000, dtype=torch.int64), torch.arange(4000)), 5.0)
    moved = (pose.position - told.position) * 1e3
    assert torch.allclose(moved.std(0), torch.tensor([5.0, 5.0, 0.0]).double(), atol=0.3)
    turned = torch.rad2deg(geodesic(pose.rotation, told.rotation))
    assert float(turned.square().mean().sqrt()) == pytest.approx(5.0 * 3**0.5, rel=0.05)


def _upright():
    pose = Pose(torch.zeros(1, 3).double(), torch.eye(3).double()[None])
    return pose_to_parameters(pose, torch.zeros(1, 6).double())


def test_blur_is_a_gaussian(learned):
    images = learned.scouts[0, :3]
    for deviation in (0.5, 2.0, 6.0):
        found = blurred(images, deviation).numpy().astype(int)
        for each, own in zip(images.numpy().astype(float), found, strict=True):
            expected = gaussian_filter(each, deviation, mode="nearest", truncate=4.0)
            assert abs(expected.round() - own).max() <= 1
    flat = torch.full((1, 128, 128), 77, dtype=torch.uint8)
    assert torch.equal(blurred(flat, 3.0), flat)


class Shown:
    """Adapts by remembering which scout it was shown, and draws its last frame."""

    name, scout, stochastic, conditional, trained = "shown", 1, False, True, True
    frame = torch.zeros(128, 128, dtype=torch.uint8)

    def adapt(self, images, parameters, seed):
        new = Shown()
        new.frame = images[-1]
        return new

    def generate(self, parameters, seed=0):
        return self.frame.repeat(len(parameters), 1, 1)


def test_a_generator_is_shown_the_scout_of_each_place(whom, learned, tmp_path):
    point = Drawn("", "", Shown(), tmp_path)
    images = draw(point, whom, learned)
    assert point.kind() == "adapts" and point.weights == {}
    assert all(
        torch.equal(images[i], learned.scouts[row, -1]) for i, row in enumerate(learned.rows)
    )
    mean = draw(Mean("", ""), whom, learned)
    exact = learned.scouts.double().mean(1).round()
    assert torch.equal(mean.double(), exact[learned.rows])


def test_specs():
    points = open_points(["truth", "soft=truth:blur=4,stray=2", "nearest-pose", "truth:wrong=0.5"])
    assert [each.label for each in points] == ["truth", "soft", "nearest-pose", "truth:wrong=0.5"]
    assert points[1] == Truth("soft", "truth:blur=4,stray=2", blur=4.0, stray=2.0)
    assert [each.kind() for each in points] == ["truth", "truth", "floor", "truth"]
    published = open_point("cgan:models/weights/cgan")
    assert published.label == "cgan" and published.kind() == "ignores the patient"
    assert published.weights
    second = open_point("scout-attention:models/weights/patients/scout-attention/seed-1")
    assert (second.label, second.kind()) == ("scout-attention, seed-1", "adapts")


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("truth:fog=1", "no 'fog': choose of blur, stray, wrong"),
        ("truth:blur", "'blur': write NAME=NUMBER"),
        ("truth:wrong=2", "wrong is a share"),
        ("truth:blur=-1", "blur and stray are 0 or more"),
        ("cgan:/nowhere", "no trained generator in /nowhere"),
        ("cgan", "racines train generator cgan --tier patients"),
        ("nobody", "nobody"),
        ("truth:blur=nan", "blur and stray are 0 or more"),
        ("truth:blur=1,blur=2", "blur is given twice"),
        ("noise-ceiling", "it draws no other pose"),
        ("mine.onnx", "a file cannot adapt to a patient"),
    ],
)
def test_specs_that_are_refused(spec, said):
    with pytest.raises(RacinesError, match=said):
        open_point(spec)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"split": "train"}, "choose validation or test"),
        ({"judged": 1001}, r"downstream.judged: 1001: give 1 to 1000"),
        ({"patients": 41}, r"downstream.patients: 41: give 1 to 40"),
        ({"views": ("A4C", "XX")}, "choose of A4C, SC, PL, PSAV, PSMV, each once"),
        ({"views": ("SC", "SC")}, "each once"),
        ({"widths": (4, 8, 8, 8, 8)}, "give 5 multiples of 8"),
    ],
)
def test_settings_that_are_refused(settings, said):
    with pytest.raises(RacinesError, match=said):
        DownstreamConfig(**settings)


def test_points_that_are_refused_before_anybody_is_examined(tmp_path):
    with pytest.raises(RacinesError, match="two points are called 'truth'"):
        open_points(["truth", "truth=truth:blur=1"])
    with pytest.raises(RacinesError, match="name one at least"):
        open_points([])
    twice = DownstreamConfig(points=("truth", "again=truth"))
    with pytest.raises(RacinesError, match="two of them draw the same"):
        measure_points(twice, tmp_path)
    with pytest.raises(RacinesError, match="nowhere"):
        measure_points(DownstreamConfig(pose="nowhere"), tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(RacinesError, match="frames and places are at least 1"):
        LessonConfig(places=0)


def test_the_name_of_a_file_tells_all_that_decides_it(tmp_path, monkeypatch):
    truth, config = open_point("truth"), DownstreamConfig()
    first = point_file(truth, config, tmp_path)
    assert first == point_file(open_point("mine=truth"), replace(config, points=()), tmp_path)
    changed = [replace(config, seed=1), replace(config, images=128), replace(config, judged=3)]
    changed += [replace(config, lessons=LessonConfig(frames=5)), replace(config, pose="nowhere")]
    names = {point_file(truth, each, tmp_path) for each in changed}
    names |= {
        point_file(open_point(each), config, tmp_path) for each in ("truth:blur=1", "scout-mean")
    }
    monkeypatch.setattr(ServoConfig, "__init__", _quicker(ServoConfig.__init__))
    names.add(point_file(truth, config, tmp_path))
    assert len(names | {first}) == 9


def _quicker(init):
    def made(self, *args, **settings):
        init(self, *args, **settings | {"learning_rate": 1.0})

    return made


def rows_of(values, found, kinds=None):
    """Return points whose metrics all are `values`, (points, patients), and who found what."""
    rows = []
    for i, (own, its) in enumerate(zip(values, found, strict=True)):
        pseudo = {name: (own * better).tolist() for name, better in METRICS.items()}
        metrics = {name: {"value": float(np.mean(each))} for name, each in pseudo.items()}
        episodes = {name: [its.tolist()] for name in ("success_declared", "final_grade")} | {
            "position_error": [(-its).tolist()]
        }
        rows.append({
            "label": str(i), "spec": str(i), "kind": kinds[i] if kinds else "truth",
            "metrics": metrics, "pseudo": pseudo,
            "found": {"A4C": episodes, "patients": np.repeat(np.arange(len(its) // 2), 2).tolist()},
        })  # fmt: skip
    return rows


def test_correlations_against_scipy_and_by_patient():
    chance = np.random.default_rng(3)
    quality = np.linspace(0.0, 1.0, 12)
    values = quality[:, None] + chance.normal(0.0, 0.3, (12, 9))
    found = quality[:, None] + chance.normal(0.0, 0.3, (12, 20))
    rows = rows_of(values, found, ["truth"] * 6 + ["adapts"] * 6)
    told = correlations(rows, 400)
    assert {each["points"]: each["n"] for each in told} == {
        "all points": 12, "generators and floors": 6, "the truth, as it is and made worse": 6,
    }  # fmt: skip
    for each in told:
        if each["points"] != "all points":
            continue
        rho, _ = spearmanr(values.mean(1), found.mean(1))
        assert each["spearman"]["value"] == pytest.approx(rho)
        assert each["spearman"]["low"] <= rho <= each["spearman"]["high"] <= 1.0
    noiseless = correlations(
        rows_of(np.repeat(quality[:, None], 9, 1), found * 0 + quality[:, None])
    )
    assert {each["spearman"][end] for each in noiseless for end in ("value", "low", "high")} == {
        1.0
    }
    few = correlations(rows_of(values[:4, :1], found[:4, :2]), 10)  # one patient of each
    assert {each["n"] for each in few} == {4}
    flat = correlations(rows_of(values, found * 0.0), 10)
    assert all(each["kendall"]["value"] is None for each in flat)


def test_intervals_stand_about_values_that_are_no_mean():
    rows = rows_of(
        np.arange(5.0)[:, None] + np.zeros((5, 6)), np.arange(5.0)[:, None] + np.zeros((5, 8))
    )
    for row, shift in zip(rows, (9.0, -9.0, 5.0, -5.0, 0.0), strict=True):
        row["pseudo"]["fid"] = [each + shift for each in row["pseudo"]["fid"]]
    told = [each for each in correlations(rows, 50) if each["metric"] == "fid"]
    assert {each["spearman"]["low"] for each in told} == {1.0}


def test_scores_lie_between_their_anchors():
    values = np.array([[1.0, 3.0], [0.0, 0.0], [1.0, 0.0]])
    rows = rows_of(values, np.zeros((3, 4)))
    add_scores(rows, Anchors())
    assert SCORE not in rows[0]["metrics"] and BOARD not in rows[0]["metrics"]
    for row, spec in zip(rows, ("truth", "scout-mean", "cgan"), strict=True):
        row["spec"] = spec
    down = (0.0, -4.0)
    add_scores(rows, Anchors((0.0, 4.0), (0.0, 4.0), down, down, (0.0, 4.0)))
    assert [row["metrics"][SCORE]["value"] for row in rows] == pytest.approx([1.0, 0.0, 0.25])
    assert rows[2]["pseudo"][SCORE] == pytest.approx([0.5, 0.0])
    assert [row["metrics"][BOARD]["value"] for row in rows] == pytest.approx([0.5, 0.0, 0.125])
    with pytest.raises(RacinesError, match="its value at 0 and at 1"):
        Anchors(ssim=(0.0, 1.0))


def test_the_anchors_of_the_profile_are_those_of_the_board():
    settings = fill(DownstreamConfig, read_params(profile="reference")["downstream"], "downstream")
    pinned = json.loads((ROOT / "leaderboard/results/patients/board.json").read_text())
    values = pinned["patient-generators"]["anchors"]["values"]
    assert {name: list(ends) for name, ends in asdict(settings.anchors).items()} == values
    assert len(settings.points) >= 20 and len(open_points(settings.points)) == len(settings.points)
