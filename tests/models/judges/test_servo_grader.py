"""A grader that begins as a servo: its encoder, what it learns, what is refused."""

import dataclasses
import json
from types import SimpleNamespace

import pytest
import torch
from typer.testing import CliRunner

from racines_data.config import Settings, fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.cli.command import app
from racines_models.judges.grader.model import Grader, StageConfig, grader_of
from racines_models.judges.grader.servo import POLICY, ServoGrader, ServoGraderConfig
from racines_models.judges.grader.training import train_grader
from racines_models.networks.servo import ServoNetwork
from racines_models.protocol import Run
from racines_models.weights import publish, save_weights

WIDTHS, BLOCKS = (4, 6, 8, 10), (2, 1, 1)


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """The folder of a servo whose numbers no fresh network has."""
    folder = tmp_path_factory.mktemp("servo")
    torch.manual_seed(5)
    network = ServoNetwork(5, WIDTHS, BLOCKS)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.1, 0.1)
    save_weights(folder / "policy.safetensors", network.state_dict())
    return SimpleNamespace(folder=folder, network=network.eval())


@pytest.fixture(scope="module")
def config(servo):
    return ServoGraderConfig(
        input_size=32, servo=str(servo.folder), widths=WIDTHS, blocks=BLOCKS, batch_size=16,
        view_stage=StageConfig(epochs=2, learning_rate=5e-3),
        grade_stage=StageConfig(epochs=8, learning_rate=5e-3, grade_weight=0.5),
        bf16=False, checkpoint_seconds=1e9,
    )  # fmt: skip


@pytest.fixture(scope="module")
def taught(labelled, config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("taught")
    return folder, train_grader(labelled, config, quiet(folder), ServoGrader)


def quiet(folder, seed=0) -> Run:
    return Run(folder, seed=seed, device="cpu", progress=False)


def test_its_encoder_begins_as_the_servos(servo, config, labelled):
    network = ServoGrader.build(config, 6)
    images = labelled.images[:8]
    x = network.normalise(images)
    before = network.encoder.eval()(x)
    ServoGrader.begin(network, config)
    small = torch.nn.functional.avg_pool2d(images.unsqueeze(1).float(), 4) / 255.0
    with torch.inference_mode():
        wanted = servo.network.features(small)
    torch.testing.assert_close(network.encoder(x), wanted, atol=1e-5, rtol=1e-4)
    assert not torch.allclose(before, wanted, atol=1e-2)


def test_a_frozen_encoder_stays_the_servos(servo, config, labelled, tmp_path):
    still = StageConfig(epochs=1, encoder_rate=0.0, grade_weight=0.5)
    frozen = dataclasses.replace(config, view_stage=still, grade_stage=still)
    train_grader(labelled, frozen, quiet(tmp_path), ServoGrader)
    loaded, own = Grader.load(tmp_path).network.state_dict(), servo.network.state_dict()
    assert all(torch.equal(loaded[f"encoder.{key}"], own[key]) for key in own if "body" in key)


def test_it_learns_views_and_grades_of_held_out_sweeps(taught):
    metrics = taught[1]["metrics"]
    assert metrics["view_accuracy"]["value"] > 0.9
    assert metrics["grade_mae"]["value"] < 1.8  # a constant guess is off by 2.25


def test_its_folder_is_opened_as_any_graders(taught, servo, labelled, tmp_path):
    images = labelled.images[labelled.split_indices("test")]
    grader = Grader.load(taught[0])
    told = json.loads((taught[0] / "config.json").read_text())["began_as"]
    assert told == {"servo": str(servo.folder), "sha256": sha256_file(servo.folder / POLICY)}
    assert type(grader) is ServoGrader and grader.settings["id"] == "racines-grader-servo"
    publish(taught[0], tmp_path / "small", "int8")
    small = Grader.load(tmp_path / "small")
    apart = [a - b for a, b in zip(grader.read(images), small.read(images), strict=True)]
    assert 0.0 < float(apart[1].abs().mean()) < 0.1
    alone = small.read(images[3:4])
    assert torch.equal(small.read(images).grades[3:4], alone.grades)


def test_settings_name_the_architecture(config):
    kind, stated = grader_of(Settings({"architecture": "servo", "batch_size": 8}, "p"))
    assert kind is ServoGrader and fill(kind.Config, stated, "grader").batch_size == 8
    assert grader_of(Settings({}, "p")) == (Grader, {})
    with pytest.raises(RacinesError, match="architecture 'student': is not trained from the tr"):
        grader_of(Settings({"architecture": "student"}, "p"))
    with pytest.raises(RacinesError, match="unknown architecture 'servos': did you mean 'servo'"):
        grader_of(Settings({"architecture": "servos"}, "p"))


def test_what_does_not_fit_is_refused(config, tmp_path):
    network = ServoGrader.build(config, 6)
    with pytest.raises(RacinesError, match=r"no such file; name a trained servo's folder as gr"):
        ServoGrader.begin(network, dataclasses.replace(config, servo=str(tmp_path)))
    other = dataclasses.replace(config, blocks=(1, 1, 1))
    with pytest.raises(RacinesError, match=r"does not fit grader\.widths .* its config\.json"):
        ServoGrader.begin(ServoGrader.build(other, 6), other)
    with pytest.raises(RacinesError, match="4 of them look at images of 32 pixels, and grader.in"):
        dataclasses.replace(config, input_size=64)
    with pytest.raises(RacinesError, match=r"grader\.width: is ResNet-18's"):
        dataclasses.replace(config, width=0.5)


def test_the_command_trains_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    params = tmp_path / "params.yaml"
    params.write_text("board: b\ngrader: {architecture: servo, widths: [4]}\n")
    done = CliRunner().invoke(app, ["train", "grader", "--params", str(params), "--data", "none"])
    assert "grader.widths: 1 of them look at images of 4 pixels" in str(done.exception)
