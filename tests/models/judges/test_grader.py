import json

import pytest
import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.randomness import sample_seeds
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork, StageConfig
from racines_models.judges.grader.report import compare, confusion_counts
from racines_models.judges.grader.training import (
    class_weights,
    grade_loss,
    learning_rate,
    train_grader,
    view_loss,
)
from racines_models.protocol import Run
from racines_models.training.augmentation import augment
from racines_models.training.checkpoint import Checkpoint
from tests.models.labelled import LabelledStore

CONFIG = GraderConfig(
    input_size=32,
    width=0.125,
    batch_size=16,
    view_stage=StageConfig(epochs=8, learning_rate=5e-3),
    grade_stage=StageConfig(epochs=8, learning_rate=5e-3, grade_weight=0.5),
    bf16=False,
    checkpoint_seconds=1e9,
)
SHORT = GraderConfig(
    input_size=32,
    width=0.125,
    batch_size=16,
    view_stage=StageConfig(epochs=1),
    grade_stage=StageConfig(epochs=1, encoder_rate=0.3, grade_weight=0.5),
    bf16=False,
    checkpoint_seconds=1e9,
)


def run(folder, resume=None, seed=0):
    return Run(folder, seed=seed, device="cpu", resume=resume, progress=False)


def test_it_learns_views_and_grades_of_held_out_sweeps(taught):
    folder, metrics = taught
    accuracy, error = metrics["metrics"]["view_accuracy"], metrics["metrics"]["grade_mae"]
    assert accuracy["value"] > 0.9 and accuracy["n"] == 108
    assert error["value"] < 1.5  # a constant guess is off by 2.25
    assert error["low"] < error["value"] < error["high"] and error["n"] == 90
    assert set(metrics["views"]) == {"A4C", "SC", "PL", "PSAV", "PSMV", "Random"}
    counts = torch.tensor(metrics["confusion"]["counts"])
    assert counts.sum() == 108 and counts.diagonal().sum() / 108 == accuracy["value"]
    assert json.loads((folder / "metrics.json").read_text()) == metrics
    assert not (folder / "checkpoint").exists()


def test_a_loaded_grader_judges_as_the_saved_one(taught, labelled):
    grader = Grader.load(taught[0])
    images = labelled.images[labelled.split_indices("test")]
    probabilities, grade = grader.probabilities_and_grade(images)
    assert probabilities.shape == (108, 6) and probabilities.dtype == torch.float32
    assert torch.allclose(probabilities.sum(1), torch.ones(108), atol=1e-5)
    assert grade.shape == (108,) and grade.min() >= 0 and grade.max() <= 10
    label, judged, features = grader.judge(images, batch_size=50)
    assert torch.equal(label, probabilities.argmax(1))
    assert torch.allclose(judged, grade, atol=1e-4)
    assert torch.allclose(features, grader.features(images), atol=1e-4)
    right = (label == labelled.views[labelled.split_indices("test")]).double().mean()
    assert float(right) == taught[1]["metrics"]["view_accuracy"]["value"]


def test_random_frames_get_low_grades(taught, labelled):
    rows = labelled.split_indices("test")
    rows = rows[labelled.views[rows] == 5]
    _, grade = Grader.load(taught[0]).probabilities_and_grade(labelled.images[rows])
    assert float(grade.mean()) < 1.0


class Killed(Exception):
    pass


def test_a_checkpoint_of_other_settings_is_not_continued(labelled, tmp_path, monkeypatch):
    each_step = GraderConfig(**{**vars(SHORT), "checkpoint_seconds": 0.0})

    def die(self, state, write=Checkpoint.write):
        write(self, state)
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "write", die)
        with pytest.raises(Killed):
            train_grader(labelled, each_step, run(tmp_path))
    with pytest.raises(RacinesError, match="another seed.*--fresh"):
        train_grader(labelled, each_step, run(tmp_path, resume=True, seed=1))


def test_seeds_decide_the_weights(labelled, tmp_path):
    store = LabelledStore(trajectories=10, length=6)
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train_grader(store, SHORT, run(tmp_path / name, seed=seed))
    a, b, c = ((tmp_path / name / "grader.safetensors").read_bytes() for name in "abc")
    assert a == b != c


def test_a_frozen_encoder_keeps_the_features_of_the_view_stage(tmp_path):
    store = LabelledStore(trajectories=10, length=6)
    views_only = GraderConfig(**{**vars(SHORT), "grade_stage": StageConfig(epochs=0)})
    frozen = StageConfig(epochs=2, encoder_rate=0.0, grade_weight=1.0)
    train_grader(store, views_only, run(tmp_path / "views"))
    frozen_config = GraderConfig(**{**vars(SHORT), "grade_stage": frozen})
    train_grader(store, frozen_config, run(tmp_path / "both"))
    views, both = (Grader.load(tmp_path / name) for name in ("views", "both"))
    assert torch.equal(views.features(store.images), both.features(store.images))
    grades = [g.probabilities_and_grade(store.images)[1] for g in (views, both)]
    assert not torch.equal(*grades)


def test_absent_labels_are_masked(tmp_path):
    store = LabelledStore(trajectories=10, length=6)
    store.views[::2] = -1
    store.grades[1::3] = torch.nan
    metrics = train_grader(store, SHORT, run(tmp_path))
    assert metrics["metrics"]["view_accuracy"]["n"] == 9  # of 18 test frames
    state = Grader.load(tmp_path).network.state_dict()
    assert all(bool(value.isfinite().all()) for value in state.values())


def test_data_without_views_are_refused(tmp_path):
    store = LabelledStore(trajectories=10, length=6)
    store.views[:] = -1
    store.manifest["source"] = "tracked"
    with pytest.raises(RacinesError, match="tracked.*has a view.*data build"):
        train_grader(store, SHORT, run(tmp_path))


def test_loading_refuses_what_is_not_a_grader(taught, tmp_path):
    with pytest.raises(RacinesError, match="racines train grader"):
        Grader.load(tmp_path)
    folder = taught[0]
    for name in ("config.json", "grader.safetensors"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    content = bytearray((tmp_path / "grader.safetensors").read_bytes())
    content[-1] ^= 1
    (tmp_path / "grader.safetensors").write_bytes(content)
    with pytest.raises(RacinesError, match="damaged"):
        Grader.load(tmp_path)
    (tmp_path / "config.json").write_text('{"schema": "other"}')
    with pytest.raises(RacinesError, match="schema"):
        Grader.load(tmp_path)
    with pytest.raises(RacinesError, match="input_size"):
        GraderConfig(input_size=100)


def test_a_params_file_that_names_one_key_keeps_the_other_defaults_of_the_stage():
    config = fill(GraderConfig, {"grade_stage": {"epochs": 1}})
    assert config.grade_stage.epochs == 1
    assert config.grade_stage.grade_weight == GraderConfig().grade_stage.grade_weight > 0


def test_the_network_averages_the_image_down(labelled):
    network = GraderNetwork(32)
    x = network.normalise(labelled.images[:2])
    assert x.shape == (2, 1, 32, 32)
    block = labelled.images[0, :4, :4].double().mean() / 127.5 - 1
    assert float(x[0, 0, 0, 0]) == pytest.approx(float(block), abs=1e-5)


def test_losses_leave_out_what_is_unknown():
    logits = torch.randn(4, 6, generator=torch.Generator().manual_seed(0))
    views, weights = torch.tensor([1, -1, 5, -1]), torch.arange(1.0, 7.0)
    kept = torch.tensor([0, 2])
    expected = torch.nn.functional.cross_entropy(logits[kept], views[kept], weights)
    assert torch.allclose(view_loss(logits, views, weights), expected)
    assert float(view_loss(logits, torch.full((4,), -1), weights)) == 0
    grades = torch.tensor([1.0, torch.nan, 4.0, torch.nan])
    assert float(grade_loss(torch.tensor([1.5, 9.0, 4.0, 9.0]), grades)) == 0.125 / 2
    assert float(grade_loss(torch.ones(4), torch.full((4,), torch.nan))) == 0


def test_class_weights_balance_views(labelled):
    store = LabelledStore(trajectories=10, length=6)
    store.views[store.split_indices("train")[:30]] = 5
    weights = class_weights(store, 1.0)
    views = store.views[store.split_indices("train")]
    totals = [float(weights[label] * (views == label).sum()) for label in range(6)]
    assert max(totals) - min(totals) < 1e-4
    assert torch.equal(class_weights(store, 0.0), torch.ones(6))


def test_augmentation_is_seeded_per_image_and_leaves_black_black(labelled):
    network = GraderNetwork(64)
    images = labelled.images[:3].clone()
    images[:, :20] = 0
    x = network.normalise(images)
    seeds = sample_seeds(0, 3)
    a = augment(x, seeds, GraderConfig())
    alone = augment(x[1:2], seeds[1:2], GraderConfig())
    assert torch.equal(a[1:2], alone)
    assert bool((a[:, :, :10] == -1).all()) and not torch.equal(a, x)
    assert a.min() >= -1 and a.max() <= 1


def test_the_learning_rate_rises_then_falls():
    rates = [learning_rate(1.0, step / 100) for step in range(100)]
    peak = rates.index(max(rates))
    assert 8 <= peak <= 12 and max(rates) == pytest.approx(1.0, abs=0.05)
    assert rates[:peak] == sorted(rates[:peak]) and rates[-1] < 0.01


def test_comparison_by_hand():
    label, views = torch.tensor([0, 1, 5, 2]), torch.tensor([0, 2, 5, -1])
    grade, grades = torch.tensor([5.0, 7.0, 1.0, 3.0]), torch.tensor([5.5, 9.0, 0.0, torch.nan])
    compared = compare(label, grade, views, grades)
    values = {name: each.values.tolist() for name, each in compared.items()}
    nan = pytest.approx(float("nan"), nan_ok=True)
    assert values["view_agreement"] == [1, 0, 1, nan]
    assert values["grade_error"] == [0.5, 2, nan, nan]
    assert values["grade_agreement"] == [1, 0, nan, nan]
    assert values["grade_error_all"] == [0.5, 2, 1, nan]
    assert confusion_counts(label, views)[2][1] == 1
    unknown = torch.full((4,), -1)
    assert not compare(label, grade, unknown, torch.full((4,), torch.nan))
