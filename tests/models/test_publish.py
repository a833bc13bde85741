"""Weights to hand out: half precision, hashes, and images that hardly change."""

import json
import shutil

import pytest
import torch
from safetensors.torch import load_file, save_file
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.cli.command import app
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.registry import open_runs, weights_of
from racines_models.training.objective import Training
from racines_models.weights import SMALL, load_weights, publish

CONFIG = VaeGanConfig(
    width=8,
    encoder_width=4,
    discriminator_width=2,
    latent=8,
    embedding=8,
    learning_rate=0.01,
    training=Training(images=320, batch_size=16, precision="fp32"),
)


@pytest.fixture(scope="module")
def run(store, tmp_path_factory):
    folder = tmp_path_factory.mktemp("publish") / "vae-gan"
    VaeGan(CONFIG).fit(store, Run(folder, device="cpu", progress=False))
    return folder


def test_copy_draws_nearly_the_same_images(store, run, tmp_path):
    publish(run, tmp_path)
    poses = store.parameters[store.split_indices("test")]
    whole = VaeGan.load(run).generate(poses, 0).int()
    half = VaeGan.load(tmp_path).generate(poses, 0).int()
    difference = (whole - half).abs()
    assert int(difference.max()) <= 2
    assert float((difference > 0).float().mean()) < 0.05
    assert VaeGan.load(tmp_path).card == VaeGan.load(run).card


def test_only_large_floats_are_halved_and_come_back_as_float32(run, tmp_path):
    publish(run, tmp_path)
    stored = load_file(tmp_path / "model.safetensors")
    large = {key for key, value in stored.items() if value.numel() > SMALL}
    assert large == {key for key, value in stored.items() if value.dtype == torch.float16}
    assert "conditioning.mean" not in large and len(large) > 3
    original = load_file(run / "model.safetensors")
    for key, value in load_weights(tmp_path / "model.safetensors").items():
        assert value.dtype == original[key].dtype
        torch.testing.assert_close(value, original[key], rtol=1e-3, atol=1e-6)
    size = (tmp_path / "model.safetensors").stat().st_size
    assert size < 0.6 * (run / "model.safetensors").stat().st_size


def test_config_says_what_was_trained_and_how(run, tmp_path):
    content = publish(run, tmp_path)
    assert content == json.loads((tmp_path / "config.json").read_text())
    file = content["weights_files"]["files"]["model.safetensors"]
    assert file["bytes"] == (tmp_path / "model.safetensors").stat().st_size
    assert content["training"]["images"] == 320 and content["training"]["validation"]["n"] == 32
    assert content["name"] == "vae-gan" and content["config"]["width"] == 8


def test_a_copy_of_a_copy_is_the_same_file(run, tmp_path):
    publish(run, tmp_path / "a")
    publish(tmp_path / "a", tmp_path / "b")
    a, b = (tmp_path / name / "model.safetensors" for name in "ab")
    assert a.read_bytes() == b.read_bytes()


def test_further_seeds_are_copied_too(run, tmp_path):
    three = tmp_path / "three"
    shutil.copytree(run, three)
    for seed in ("seed-1", "seed-2"):
        shutil.copytree(run, three / seed)
    files = publish(three, tmp_path / "out")["weights_files"]["files"]
    assert (
        set(files)
        == set(weights_of("vae-gan", three))
        == set(weights_of("vae-gan", tmp_path / "out"))
    )
    first, *others = open_runs("vae-gan", tmp_path / "out")
    assert len(others) == 2 and first.card == others[0].card
    for name, told in files.items():
        assert sha256_file(tmp_path / "out" / name) == told["sha256"]
        assert sha256_file(three / name) == told["made_of"]


def test_another_file_under_the_name_is_refused(run, tmp_path):
    publish(run, tmp_path)
    (tmp_path / "model.safetensors").write_bytes((run / "model.safetensors").read_bytes())
    with pytest.raises(RacinesError, match="sha256"):
        VaeGan.load(tmp_path)


def test_refusals_name_the_folder(run, tmp_path):
    with pytest.raises(RacinesError, match="no config.json"):
        publish(tmp_path / "absent", tmp_path / "out")
    with pytest.raises(RacinesError, match="is the run itself"):
        publish(run, run)
    (tmp_path / "config.json").write_text("{}")
    save_file({"heavy": torch.full((SMALL + 1,), 1e5)}, tmp_path / "model.safetensors")
    with pytest.raises(RacinesError, match="heavy is NaN or too large"):
        publish(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out" / "config.json").exists()


def test_command(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["export", "weights", str(run), "--json"])
    assert result.exit_code == 0, result.output
    made = json.loads(result.stdout)
    assert made["out"] == "models/weights/vae-gan"
    assert (tmp_path / made["out"] / "config.json").is_file()
    result = CliRunner().invoke(app, ["export", "weights", str(run), "--out", "here"])
    assert "here/model.safetensors: " in result.stdout
