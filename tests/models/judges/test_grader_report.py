"""Calibration, report and plots of a grader, and the commands that make them."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torchmetrics.functional.classification import multiclass_calibration_error
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.judges.grader.evaluation import evaluate_grader
from racines_models.judges.grader.model import Grader, GraderNetwork
from racines_models.judges.grader.report import (
    BINS,
    balanced_accuracy,
    calibrate,
    examine,
    fit_temperature,
    reliability,
)
from racines_models.judges.grader.training import train_grader
from racines_models.training import augmentation as grader_augment
from racines_models.training.augmentation import Augmentation, augment
from racines_models.weights import publish
from tests.models.judges.test_grader import SHORT, run
from tests.models.labelled import LabelledStore

PLOTS = ["confusion.png", "reliability.png", "grades.png", "views.png"]


@pytest.fixture(scope="module")
def store():
    return LabelledStore(trajectories=20, length=12)


@pytest.fixture(scope="module")
def trained(store, tmp_path_factory, drawn_pictures):
    folder = tmp_path_factory.mktemp("grader")
    return folder, train_grader(store, SHORT, run(folder))


def overconfident(scale: float, n: int = 4000) -> tuple[torch.Tensor, torch.Tensor]:
    """Logits whose softmax is the truth's distribution, times `scale`."""
    generator = torch.Generator().manual_seed(0)
    logits = 1.5 * torch.randn(n, 6, generator=generator)
    views = torch.multinomial(logits.softmax(-1), 1, generator=generator)[:, 0]
    return logits * scale, views


@pytest.mark.parametrize("scale", [0.4, 3.0])
def test_the_temperature_mends_a_miscalibrated_grader(scale):
    logits, views = overconfident(scale)
    temperature = fit_temperature(logits, views)
    assert temperature == pytest.approx(scale, rel=0.08)
    before = reliability(logits.softmax(-1), views).error
    after = reliability((logits / temperature).softmax(-1), views).error
    assert before > 0.1 and after < 0.03


def test_the_calibration_error_is_that_of_torchmetrics():
    logits, views = overconfident(3.0)
    ours = reliability(logits.softmax(-1), views).error
    theirs = multiclass_calibration_error(logits.softmax(-1), views, 6, n_bins=BINS)
    assert ours == pytest.approx(float(theirs), abs=1e-4)


def test_unknown_views_do_not_calibrate():
    logits, views = overconfident(3.0)
    half = views.clone()
    half[::2] = -1
    assert fit_temperature(logits, half) == fit_temperature(logits[1::2], views[1::2])
    assert reliability(logits.softmax(-1), half).frames.sum() == len(views) / 2
    assert fit_temperature(logits, torch.full_like(views, -1)) == 1.0


def test_training_calibrates_on_the_validation_split(trained, store):
    folder, metrics = trained
    described = json.loads((folder / "config.json").read_text())
    assert described["temperature"] == metrics["calibration"]["temperature"] != 1.0
    assert described["calibrated"] == {"split": "validation", "frames": 24}
    grader = Grader.load(folder)
    rows = store.split_indices("validation")
    logits = grader.read(store.images[rows]).logits
    assert grader.temperature == fit_temperature(logits, store.views[rows])
    probabilities, _ = grader.probabilities_and_grade(store.images[rows])
    expected = (logits / grader.temperature).softmax(-1)
    assert torch.allclose(probabilities, expected, atol=1e-5)
    for when in ("before", "after"):
        assert metrics["calibration"][when]["n"] == 72
        assert 0 <= metrics["calibration"][when]["value"] <= 1


def test_balanced_accuracy_leaves_out_what_is_unknown_and_blocks_units():
    right = torch.tensor([1.0, 1.0, 1.0, 0.0, torch.nan, 0.0]).double()
    views = torch.tensor([0, 0, 0, 0, -1, 2])
    found = balanced_accuracy(right, views, np.array([0, 0, 1, 1, 1, 2]))
    assert found["value"] == pytest.approx((0.75 + 0.0) / 2) and found["n"] == 5
    assert found["settings"]["units"] == 3


def test_the_report_has_the_grade_error_of_each_view(trained, store):
    figures = trained[1]["grades"]
    assert set(figures) == {"A4C", "SC", "PL", "PSAV", "PSMV"}
    assert "pathologies" not in trained[1], "one heart has no patients"
    rows = store.split_indices("test")
    rows = rows[store.views[rows] == 2]
    _, grades, _ = Grader.load(trained[0]).judge(store.images[rows])
    difference = (grades - store.grades[rows]).double().numpy()
    assert figures["PL"]["mae"]["value"] == pytest.approx(np.abs(difference).mean(), abs=1e-4)
    assert figures["PL"]["bias"]["value"] == pytest.approx(difference.mean(), abs=1e-4)
    assert figures["PL"]["bias"]["low"] < figures["PL"]["bias"]["high"]
    assert figures["PL"]["mae"]["settings"]["units"] == 6


def test_the_plots_lie_beside_the_metrics(trained):
    folder, metrics = trained
    assert metrics["plots"] == PLOTS
    for name in PLOTS:
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 150 and len(set(picture.convert("L").tobytes())) > 10


def test_data_without_grades_have_no_plots_of_them(trained, tmp_path):
    store = LabelledStore(trajectories=10, length=6)
    store.grades[:] = torch.nan
    metrics = evaluate_grader(trained[0], store, "test", tmp_path, False, "cpu")
    assert metrics["plots"] == PLOTS[:2] and not metrics["grades"]
    examined = examine(Grader.load(trained[0]), store, "test")
    assert "grade_mae" not in examined.content["metrics"]


def test_a_grader_without_calibration_gets_it_and_keeps_its_history(trained, store, tmp_path):
    for name in ("config.json", "grader.safetensors", "metrics.json"):
        (tmp_path / name).write_bytes((trained[0] / name).read_bytes())
    described = json.loads((tmp_path / "config.json").read_text())
    described.pop("temperature"), described.pop("architecture")  # as graders of old
    (tmp_path / "config.json").write_text(json.dumps(described))
    assert Grader.load(tmp_path).temperature == 1.0
    plain = evaluate_grader(tmp_path, store, "test", tmp_path / "plain", False, "cpu")
    assert plain["calibration"]["before"]["value"] == plain["calibration"]["after"]["value"]
    metrics = evaluate_grader(tmp_path, store, "test", tmp_path, True, "cpu")
    assert metrics["calibration"] == trained[1]["calibration"]
    assert metrics["training"] == trained[1]["training"]
    assert Grader.load(tmp_path).temperature == metrics["calibration"]["temperature"]
    calibrated = json.loads((tmp_path / "config.json").read_text())
    assert calibrated["dataset"] == described["dataset"]


def test_an_empty_split_is_refused_and_calibrates_nothing(trained):
    store = LabelledStore(trajectories=10, length=6)
    store._splits["validation"] = [0, 0]
    with pytest.raises(RacinesError, match="no frames"):
        evaluate_grader(trained[0], store, "validation", Path("nowhere"), False, "cpu")
    grader = Grader.load(trained[0])
    assert calibrate(grader, store) == 0 and grader.temperature == 1.0


def test_a_half_precision_copy_opens_and_agrees(trained, store, tmp_path):
    publish(trained[0], tmp_path)
    for name in PLOTS:
        assert (tmp_path / name).read_bytes() == (trained[0] / name).read_bytes()
    whole, half = Grader.load(trained[0]), Grader.load(tmp_path)
    assert half.temperature == whole.temperature and half.sha256 != whole.sha256
    a, b = (g.probabilities_and_grade(store.images[:60]) for g in (whole, half))
    assert torch.allclose(a[0], b[0], atol=5e-3) and torch.allclose(a[1], b[1], atol=5e-2)
    weights = (tmp_path / "grader.safetensors").stat().st_size
    assert weights < 0.8 * (trained[0] / "grader.safetensors").stat().st_size
    content = bytearray((tmp_path / "grader.safetensors").read_bytes())
    content[-1] ^= 1
    (tmp_path / "grader.safetensors").write_bytes(content)
    with pytest.raises(RacinesError, match="damaged"):
        Grader.load(tmp_path)


def test_an_unknown_architecture_is_refused(trained, tmp_path):
    described = json.loads((trained[0] / "config.json").read_text()) | {"architecture": "vit"}
    (tmp_path / "config.json").write_text(json.dumps(described))
    with pytest.raises(
        RacinesError,
        match="config.json: unknown architecture 'vit': choose one of resnet18, servo, student",
    ):
        Grader.load(tmp_path)


def test_the_command_reports_and_refuses(trained, store, tmp_path, monkeypatch):
    monkeypatch.setattr("racines_data.store.frames.open_store", lambda root, config: store)
    words = ["eval", "grader", str(trained[0]), "--out", str(tmp_path), "--split", "train"]
    told = CliRunner().invoke(app, [*words, "--device", "cpu", "--json"])
    assert told.exit_code == 0, told.output
    assert json.loads(told.stdout)["split"] == "train"
    assert (tmp_path / "metrics.json").is_file() and (tmp_path / "views.png").is_file()
    refused = CliRunner().invoke(app, ["eval", "grader", str(tmp_path / "none"), "--device", "cpu"])
    assert refused.exit_code == 1


PARTS = {"gain": 0.3, "tgc": 0.3, "gamma": 0.3, "blur": 1.0, "erase": 1.0, "noise": 0.1}
OFF = dict.fromkeys(PARTS, 0.0)


@pytest.mark.parametrize("part", PARTS)
def test_each_part_of_the_augmentation_does_something_of_its_own(part, store):
    x = GraderNetwork(64, 0.125).normalise(store.images[:16])
    seeds = torch.arange(16)
    assert torch.allclose(augment(x, seeds, Augmentation(**OFF)), x, atol=1e-6)
    varied = augment(x, seeds, Augmentation(**OFF | {part: PARTS[part]}))
    change = (varied - x).abs().mean((1, 2, 3))
    assert bool((change > 1e-4).all()) and varied.min() >= -1 and varied.max() <= 1


def test_depth_gain_turns_about_the_middle_and_boxes_stay_small(store):
    x = torch.full((32, 1, 64, 64), -0.2)
    tgc = augment(x, torch.arange(32), Augmentation(**OFF | {"tgc": 0.1}))
    near, far = ((tgc[:, 0, row, 0] + 1) / 0.8 for row in (0, -1))
    assert torch.allclose(near * far, torch.ones(32), atol=1e-4)
    boxes = augment(x, torch.arange(32), Augmentation(**OFF | {"erase": 1.0, "erase_side": 0.25}))
    erased = (boxes == -1).float().mean((1, 2, 3))
    assert bool((erased > 0).all()) and float(erased.max()) <= 0.25**2 + 0.01
    assert grader_augment.Augmentation().erase < 0.5
