"""The student: its interface is the grader's, its answers are the teacher's."""

import json
from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.randomness import sample_seeds
from racines_models.judges.grader.model import Grader
from racines_models.judges.student import training as student_training
from racines_models.judges.student.model import Student, StudentConfig, StudentNetwork
from racines_models.judges.student.training import (
    StudentLearner,
    distillation_loss,
    speed,
    train_student,
    variants,
)
from racines_models.training.checkpoint import Checkpoint
from racines_models.weights import publish
from tests.models.judges.test_grader import Killed, run
from tests.models.labelled import LabelledStore

SMALL = StudentConfig(
    input_size=32,
    width=0.25,
    batch_size=32,
    epochs=16,
    learning_rate=5e-3,
    bf16=False,
    checkpoint_seconds=1e9,
)
SHORT = replace(SMALL, width=0.125, epochs=2)
EACH_STEP = replace(SHORT, checkpoint_seconds=0.0)


@pytest.fixture(scope="module", autouse=True)
def few_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(student_training, "ROUNDS", 2)
        yield


@pytest.fixture(scope="module")
def store(labelled):
    return labelled


@pytest.fixture(scope="module")
def teacher(taught):
    return Grader.load(taught[0])


@pytest.fixture(scope="module")
def trained(store, teacher, tmp_path_factory):
    folder = tmp_path_factory.mktemp("student")
    return folder, train_student(store, SMALL, run(folder), teacher)


def test_it_agrees_with_its_teacher_on_held_out_sweeps(trained, teacher):
    folder, metrics = trained
    agreed = metrics["agreement"]
    assert agreed["view"]["value"] > 0.9 and agreed["view"]["n"] == 108
    assert agreed["view"]["low"] <= agreed["view"]["value"] <= agreed["view"]["high"]
    assert agreed["grade_mae"]["value"] < 1.5
    assert metrics["metrics"]["view_accuracy"]["value"] > 0.85
    assert metrics["teacher"]["sha256"] == teacher.sha256
    assert metrics["speed"]["ratio"] == pytest.approx(
        metrics["speed"]["student"] / metrics["speed"]["teacher"], rel=0.01
    )
    assert json.loads((folder / "metrics.json").read_text()) == metrics
    assert not (folder / "checkpoint").exists()
    assert all((folder / name).is_file() for name in metrics["plots"])


def test_it_is_asked_as_a_grader_is(trained, store, teacher):
    student = Grader.load(trained[0])
    assert isinstance(student, Student) and student.labels == teacher.labels
    images = store.images[store.split_indices("test")]
    probabilities, grades = student.probabilities_and_grade(images)
    assert probabilities.shape == (108, 6) and probabilities.dtype == torch.float32
    assert torch.allclose(probabilities.sum(1), torch.ones(108), atol=1e-5)
    assert grades.shape == (108,) and grades.min() >= 0 and grades.max() <= 10
    labels, judged, features = student.judge(images, batch_size=50)
    assert torch.equal(labels, probabilities.argmax(1))
    assert torch.allclose(judged, grades, atol=1e-4)
    assert torch.allclose(features, student.features(images), atol=1e-4)
    assert features.shape == (108, student.network.features)
    assert student.settings["id"] == "racines-grader-student"
    student.check_labels(store.labels, "the dataset")
    with pytest.raises(RacinesError, match="the dataset has A4C"):
        student.check_labels(store.labels[:3], "the dataset")
    assert student.judge(images[:0])[0].shape == (0,)


def test_folded_batch_norm_changes_no_answer(trained, store):
    student = Grader.load(trained[0])
    x = student.network.normalise(store.images[:16])
    folded, plain = student.answer(x), student.network(x)
    assert torch.allclose(folded.logits, plain[0], atol=1e-3)
    rounded = Student(student.network, replace(SMALL, bf16=True)).answer(x)
    assert torch.equal(rounded.logits.argmax(1), folded.logits.argmax(1))
    assert not torch.equal(rounded.logits, folded.logits)


def test_its_half_precision_copy_opens_and_agrees(trained, store, tmp_path):
    publish(trained[0], tmp_path)
    whole, half = Grader.load(trained[0]), Grader.load(tmp_path)
    assert isinstance(half, Student) and half.sha256 != whole.sha256
    assert half.temperature == whole.temperature != 1.0
    images = store.images[store.split_indices("test")]
    a, b = whole.probabilities_and_grade(images), half.probabilities_and_grade(images)
    assert torch.allclose(a[0], b[0], atol=5e-3) and torch.allclose(a[1], b[1], atol=5e-2)


def test_a_killed_and_resumed_run_ends_in_the_same_weights(store, teacher, tmp_path, monkeypatch):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    train_student(store, SHORT, run(whole), teacher)
    ask, write = StudentLearner.ask_of, Checkpoint.write
    asked = []

    def ask_then_die(*args):
        if len(asked) == 1:
            raise Killed
        asked.append(args[2])
        return ask(*args)

    with monkeypatch.context() as patch:  # while the teacher is asked
        patch.setattr(StudentLearner, "ask_of", ask_then_die)
        with pytest.raises(Killed):
            train_student(store, EACH_STEP, run(broken), teacher)
    first = (broken / "checkpoint/teacher/00-0000.safetensors").stat().st_mtime_ns

    def write_then_die(self, state):
        write(self, state)
        if state["seen"] == 9 * SHORT.batch_size:
            raise Killed

    with monkeypatch.context() as patch:  # while the student learns
        patch.setattr(Checkpoint, "write", write_then_die)
        with pytest.raises(Killed):
            train_student(store, EACH_STEP, run(broken, resume=True), teacher)
    kept = (broken / "checkpoint/teacher/00-0000.safetensors").stat().st_mtime_ns
    assert kept == first  # not asked again
    train_student(store, EACH_STEP, run(broken, resume=True), teacher)
    a, b = ((folder / "grader.safetensors").read_bytes() for folder in (whole, broken))
    assert a == b


def test_the_answers_of_another_teacher_are_not_used(store, teacher, tmp_path, monkeypatch):
    def die(self, state, write=Checkpoint.write):
        write(self, state)
        if state["seen"] == SHORT.batch_size:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "write", die)
        with pytest.raises(Killed):
            train_student(store, EACH_STEP, run(tmp_path), teacher)
    other = Grader(teacher.network, teacher.config, labels=teacher.labels)
    with pytest.raises(RacinesError, match="another teacher.*--fresh"):
        train_student(store, EACH_STEP, run(tmp_path, resume=True), other)
    asked = []
    monkeypatch.setattr(other, "answer", lambda x: asked.append(len(x)) or teacher.answer(x))
    train_student(store, SHORT, run(tmp_path), other)
    assert sum(asked) >= 2 * len(store.split_indices("train"))


def test_a_variant_is_the_same_whenever_it_is_looked_at(store, teacher, tmp_path):
    rows = store.split_indices("train")[:8]
    x = teacher.network.normalise(store.take(rows).images)
    which = torch.arange(8) % 3
    whole = variants(x, rows, which, 5, SMALL)
    assert torch.equal(whole[3:5], variants(x[3:5], rows[3:5], which[3:5], 5, SMALL))
    assert torch.equal(whole[which == 0], x[which == 0])
    varied = which > 0
    assert not torch.equal(whole[varied], x[varied])
    assert not torch.equal(whole, variants(x, rows, which, 6, SMALL))
    learner = StudentLearner(store, SMALL, run(tmp_path, seed=5), teacher)
    logits, _ = learner.answers(tmp_path, lambda _: None)
    wanted = teacher.answer(variants(x, rows, torch.ones(8, dtype=torch.int64), 5, SMALL))
    assert torch.allclose(logits[1, :8], wanted.logits, atol=1e-3)


def test_the_loss_vanishes_where_the_student_agrees():
    logits = torch.randn(4, 6, generator=torch.Generator().manual_seed(0))
    assert float(distillation_loss(logits + 3.0, logits, 2.0)) == pytest.approx(0.0, abs=1e-6)
    assert float(distillation_loss(logits.flip(1), logits, 2.0)) > 0.1


def test_it_is_quicker_than_the_teacher(store):
    from racines_models.judges.grader.model import GraderConfig, GraderNetwork

    teacher = Grader(GraderNetwork(64), GraderConfig())
    measured = speed(Student(StudentNetwork(64), StudentConfig()), teacher)
    assert measured["batch_size"] == 64 and measured["ratio"] > 3.0  # far more on a quiet machine


def test_what_cannot_be_trained_is_refused(store, teacher, tmp_path):
    with pytest.raises(RacinesError, match="input_size 64: the teacher's is 32"):
        train_student(store, replace(SHORT, input_size=64), run(tmp_path), teacher)
    with pytest.raises(RacinesError, match="input_size 100"):
        StudentConfig(input_size=100)
    with pytest.raises(RacinesError, match="epochs and variants"):
        StudentConfig(variants=0)
    with pytest.raises(RacinesError, match="temperature"):
        StudentConfig(temperature=0.0)
    organ = LabelledStore(trajectories=10, length=6)
    organ.labels = ("KLX", "Random")
    with pytest.raises(RacinesError, match="KLX"):
        train_student(organ, SHORT, run(tmp_path), teacher)


def test_seeds_of_variants_differ_between_frames():
    x = torch.zeros(2, 1, 32, 32)
    one = variants(x, torch.tensor([0, 1]), torch.ones(2, dtype=torch.int64), 0, SMALL)
    assert not torch.equal(one[0], one[1])
    assert sample_seeds(0, 1).dtype == torch.int64
