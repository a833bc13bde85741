"""What judges answer and learn, by hand and without training one."""

import math
from types import SimpleNamespace

import pytest
import torch
from torch.nn import functional

from racines_data.geometry import Pose, axis_angle_to_matrix, parameters_to_pose
from racines_models.judges.grader import training as grader_training
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork, StageConfig
from racines_models.judges.grader.report import Reliability, compare, confusion_counts, reliability
from racines_models.judges.grader.training import learning_rate
from racines_models.judges.pose.regressor import PoseAugmentation, PoseConfig, PoseRegressor
from racines_models.judges.pose.training import PoseLearner, pose_errors
from racines_models.judges.pose.training import report as pose_report
from racines_models.judges.student.model import Block, Student, StudentConfig, StudentNetwork
from racines_models.judges.student.training import (
    StudentLearner,
    agreement,
    distillation_loss,
    variants,
)
from racines_models.protocol import Run
from racines_models.training.objective import TrainBatch
from tests.models.conftest import pictures, random_parameters
from tests.models.labelled import LabelledStore

OFF = {"gain": 0.0, "tgc": 0.0, "gamma": 0.0, "blur": 0.0, "erase": 0.0, "noise": 0.0}
CONFIG = GraderConfig(
    input_size=32, width=0.125, batch_size=16, bf16=False, weight_decay=0.0,
    view_stage=StageConfig(epochs=2), grade_stage=StageConfig(epochs=1, grade_weight=0.5),
)  # fmt: skip


@pytest.fixture(scope="module")
def store() -> LabelledStore:
    return LabelledStore(trajectories=10, length=6)


def untrained(kind: str, temperature: float = 1.0) -> Grader:
    torch.manual_seed(0)
    if kind == "student":
        config = StudentConfig(input_size=32, width=0.25, bf16=False)
        return Student(StudentNetwork(32, 0.25), config, temperature=temperature)
    return Grader(GraderNetwork(32, 0.125), CONFIG, temperature=temperature)


@pytest.mark.parametrize("kind", ["grader", "student"])
def test_probabilities_are_softened_by_the_temperature(kind, store):
    judge = untrained(kind, 4.0)
    logits = judge.read(store.images).logits
    probabilities, _ = judge.probabilities_and_grade(store.images)
    assert torch.allclose(probabilities, (logits / 4.0).softmax(-1), atol=1e-5)
    assert not torch.allclose(probabilities, logits.softmax(-1), atol=1e-3)


@pytest.mark.parametrize("kind", ["grader", "student"])
def test_grades_lie_in_0_to_10(kind, store):
    judge = untrained(kind)
    for bias, expected in ((9.0, 10.0), (-9.0, 0.0)):
        with torch.no_grad():
            judge.network.grade_head[2].bias.fill_(bias)
        assert judge.read(store.images).grades.tolist() == [expected] * len(store.images)


def test_a_block_adds_its_input():
    torch.manual_seed(0)
    block, x = Block(4, 4).eval(), torch.rand(1, 4, 8, 8)
    assert torch.allclose(block(x), x + block.conv(x).div((1 + 1e-5) ** 0.5).relu(), atol=1e-5)


def learner_of(store, folder) -> grader_training.GraderLearner:
    run = Run(folder, seed=0, device="cpu", resume=None, progress=False)
    return grader_training.GraderLearner(store, CONFIG, run)


def test_the_view_stage_leaves_the_grade_head_and_the_grade_stage_does_not(store, tmp_path):
    learner = learner_of(store, tmp_path)
    weight, moved = learner.network.grade_head[0].weight, {}
    for batch in learner.batches(0, learner.steps * 16):
        (update,) = learner.updates(learner.modules(), batch)
        learner.network.zero_grad()
        update.loss.backward()
        moved.setdefault(update.optimizer, []).append(bool(weight.grad.any()))
    assert moved == {"views": [False] * 4, "grades": [True] * 2}


def test_each_step_augments_anew_and_by_the_seed(store, tmp_path, monkeypatch):
    seeds, augment = [], grader_training.augment

    def spied(x, seed, config):
        seeds.append(seed)
        return augment(x, seed, config)

    monkeypatch.setattr(grader_training, "augment", spied)
    learner = learner_of(store, tmp_path)
    for batch in learner.batches(0, learner.steps * 16):
        next(learner.updates(learner.modules(), batch))
    assert len(torch.cat(seeds).unique()) == 6 * 16


def test_rates_rise_over_a_tenth_and_reach_zero():
    assert learning_rate(2.0, 0.0) == pytest.approx(2.0 * 1e-3 / 0.101)
    assert learning_rate(2.0, 0.05) == pytest.approx(2.0 * 0.051 / 0.101)
    assert learning_rate(2.0, 0.1) == pytest.approx(2.0)
    assert learning_rate(2.0, 0.55) == pytest.approx(1.0)
    assert learning_rate(2.0, 1.0) == pytest.approx(0.0)


def test_grades_agree_that_differ_by_one_and_random_has_none():
    views, grades = torch.tensor([0, 1, 2, 5]), torch.tensor([5.0, 5.0, 5.0, 0.0])
    compared = compare(views, torch.tensor([6.0, 3.5, 5.5, 0.5]), views, grades)
    nan = pytest.approx(float("nan"), nan_ok=True)
    assert compared["grade_agreement"].values.tolist() == [1.0, 0.0, 1.0, nan]
    assert compared["grade_error_all"].values.tolist() == [1.0, 1.5, 0.5, 0.5]


def test_rows_of_the_confusion_are_the_truth():
    counts = confusion_counts(torch.tensor([1, 1, 0, 2]), torch.tensor([0, 0, 1, -1]), 3)
    assert counts == [[0, 2, 0], [1, 0, 0], [0, 0, 0]]


def test_bins_are_closed_above():
    sure = torch.tensor([0.5, 0.6, 1.0, 0.55], dtype=torch.float64)  # 7.5, 9, 15 and 8.25 bins
    bins = reliability(torch.stack([sure, 1 - sure], 1), torch.tensor([0, 1, 0, -1]))
    assert bins.frames.nonzero()[:, 0].tolist() == [7, 8, 14]
    assert bins.confidence[[7, 8, 14]].tolist() == pytest.approx([0.5, 0.6, 1.0])
    assert bins.accuracy[[7, 8, 14]].tolist() == [1.0, 0.0, 1.0]


def test_the_calibration_error_weighs_bins_by_their_frames():
    bins = (torch.tensor(x, dtype=torch.float64) for x in ([1, 3], [0.9, 0.5], [0.5, 0.6]))
    assert Reliability(*bins).error == pytest.approx((1 * 0.4 + 3 * 0.1) / 4)


def test_distillation_is_the_divergence_times_the_squared_temperature():
    ours, theirs = torch.tensor([[2.0, 0.0]]), torch.tensor([[0.0, 1.0]])
    p, q = (theirs / 2).softmax(-1), (ours / 2).softmax(-1)
    expected = 4.0 * float((p * (p / q).log()).sum())
    assert float(distillation_loss(ours, theirs, 2.0)) == pytest.approx(expected, rel=1e-5)


def test_a_frame_is_seen_once_an_epoch_in_variant_after_variant():
    config = StudentConfig(epochs=4, variants=3)
    run = SimpleNamespace(per_epoch=3, seed=0, batch_size=4, config=config)
    run.rows = torch.arange(12)
    batches = list(StudentLearner.batches(run, 0, 48))  # pyright: ignore[reportArgumentType]
    epochs = [batches[i : i + 3] for i in range(0, 12, 3)]
    for epoch in epochs:
        assert sorted(torch.cat([places for places, _ in epoch]).tolist()) == list(range(12))
    seen = [int(which[places == 5]) for places, which in batches if 5 in places]
    assert seen == [2, 0, 1, 2]
    resumed = list(StudentLearner.batches(run, 16, 48))  # pyright: ignore[reportArgumentType]
    assert all(torch.equal(a[0], b[0]) for a, b in zip(resumed, batches[4:], strict=True))


def test_a_variant_is_the_frames_own_and_the_first_is_the_frame():
    rows, which = torch.arange(9), torch.arange(9) % 3
    x = torch.rand(9, 1, 32, 32) * 2 - 1
    whole = variants(x, rows, which, 5, StudentConfig())
    assert torch.equal(whole[which == 0], x[which == 0])
    assert bool((whole - x)[which > 0].abs().amax((1, 2, 3)).gt(1e-4).all())
    assert torch.equal(whole[3:5], variants(x[3:5], rows[3:5], which[3:5], 5, StudentConfig()))
    for other in (variants(x, rows, which, 6, StudentConfig()),
                  variants(x, rows + 9, which, 5, StudentConfig()),
                  variants(x, rows, which * 2, 5, StudentConfig())):  # fmt: skip
        assert not torch.equal(other[which > 0], whole[which > 0])


def test_a_poses_error_is_in_millimetres_and_degrees():
    parameters = random_parameters(6, 0)
    pose = parameters_to_pose(parameters.double())
    turn = axis_angle_to_matrix(torch.tensor([0.0, 0.0, 0.1], dtype=torch.float64))
    moved = Pose(pose.position + torch.tensor([0.003, 0.004, 0.0]), pose.rotation @ turn)
    millimetres, degrees = pose_errors(moved, parameters)
    assert millimetres.tolist() == pytest.approx([5.0] * 6)
    assert degrees.tolist() == pytest.approx([math.degrees(0.1)] * 6)


def test_frames_of_a_view_are_told_apart_from_those_that_show_nothing(store):
    config = PoseConfig(width=0.125)
    metrics = pose_report(PoseRegressor(PoseLearner(config, 0, {}).network, config), store)
    counts = {name: each["n"] for name, each in metrics["metrics"].items()}
    assert counts["pose_error_mm"] == 18 and counts["pose_error_mm_view"] == 15


def test_the_student_is_compared_on_what_the_teacher_calls_a_view(store):
    class Says:
        labels = store.labels

        def __init__(self, labels, grade):
            self.answer = labels, torch.full((18,), grade), torch.zeros(18, 1)

        def judge(self, images):
            return self.answer

    theirs = torch.arange(18) % 6
    ours = theirs.clone()
    ours[0] = 3
    compared = agreement(Says(ours, 6.5), Says(theirs, 5.0), store)
    assert compared["view"]["value"] == pytest.approx(17 / 18)
    assert compared["grade_mae"]["value"] == 1.5 and compared["grade_mae"]["n"] == 15


def test_the_pose_loss_is_that_of_positions_and_rotations():
    config = PoseConfig(width=0.125, augmentation=PoseAugmentation(**OFF))
    learner = PoseLearner(config, 0, {})
    parameters = random_parameters(32, 0)
    learner.network.fit_targets(parameters)
    learner.network.eval()
    images, seeds = pictures(parameters[:4]), torch.arange(4)
    batch = TrainBatch(images=images, parameters=parameters[:4], seeds=seeds)
    (update,) = learner.updates(learner.modules(), batch)
    found = learner.network(learner.network.normalise(images))
    target = learner.network.targets(parameters[:4])
    error = functional.smooth_l1_loss(found, target, beta=0.1, reduction="none")
    expected = error[:, :3].mean() + error[:, 3:].mean()
    assert torch.allclose(update.loss, expected)


def test_each_target_has_a_scale_of_its_own():
    network = PoseLearner(PoseConfig(width=0.125), 0, {}).network
    parameters = random_parameters(500, 0)
    network.fit_targets(parameters)
    assert torch.allclose(network.targets(parameters).std(0), torch.ones(9), atol=1e-3)
    raw = torch.rand(2, 9)
    position = raw[:, :3] * network.std[:3] + network.mean[:3]
    assert torch.allclose(network.pose(raw).position, position)


@pytest.mark.parametrize(("units", "precision"), [(False, "fp32"), (True, "bf16")])
def test_training_is_in_bfloat16_where_there_are_units_for_it(
    store, tmp_path, monkeypatch, units, precision
):
    class Stopped(Exception):
        pass

    told = []

    def train(learner, data, settings, *more):
        told.append(settings.precision)
        raise Stopped

    monkeypatch.setattr(grader_training, "has_bfloat16", lambda _: units)
    monkeypatch.setattr(grader_training, "train", train)
    for config in (GraderConfig(width=0.125), GraderConfig(width=0.125, bf16=False)):
        with pytest.raises(Stopped):
            grader_training.train_grader(store, config, Run(tmp_path, 0))
    assert told == [precision, "fp32"]
