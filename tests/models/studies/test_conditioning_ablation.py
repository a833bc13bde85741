"""The four ways to tell a generator its pose: trained alike, judged alike, not trained twice."""

import json

import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.generators.cgan import Cgan, CganConfig
from racines_models.generators.mean_image import MeanImage, MeanImageConfig
from racines_models.protocol import Run
from racines_models.sample import take_sample
from racines_models.studies.conditioning import judge, run_ablation
from racines_models.training.objective import Training
from tests.models.conftest import FakeStore

CONFIG = CganConfig(
    width=2,
    discriminator_width=2,
    latent=4,
    embedding=4,
    learning_rate=0.03,
    training=Training(images=64, batch_size=16, precision="fp32", ema=0.0),
)
NAMES = ["continuous-concat", "continuous-norm", "euler-concat", "euler-norm"]


@pytest.fixture(scope="module")
def store() -> FakeStore:
    store = FakeStore()
    store.trajectory_index = torch.arange(len(store.images)) // 8
    return store


def test_four_variants_are_trained_once_and_judged(store, tmp_path, monkeypatch):
    run = Run(tmp_path, seed=2, device="cpu", progress=False)
    content = run_ablation(Cgan, CONFIG, store, run, frames=8)
    chosen = take_sample(store, "validation", 8)
    assert (content["split"], content["sample"]) == ("validation", chosen.digest)
    assert [row["name"] for row in content["variants"]] == NAMES
    written = json.loads((tmp_path / "conditioning.json").read_text())
    assert written["variants"] == content["variants"]
    for row in content["variants"]:
        config = Cgan.load(tmp_path / row["name"]).config
        assert (config.conditioning, config.injection) == (row["conditioning"], row["injection"])
        assert 0 < row["psnr"] < 40 and 0 <= row["own_frame"] <= 1

    def refuse(*_):
        raise AssertionError("trained again")

    monkeypatch.setattr(Cgan, "fit", refuse)
    assert run_ablation(Cgan, CONFIG, store, run, frames=8) == content
    with pytest.raises(AssertionError, match="trained again"):
        run_ablation(Cgan, CONFIG, store, Run(tmp_path, seed=3, progress=False), frames=8)


def test_judge_knows_a_generator_that_sees_the_pose_from_one_that_does_not(store):
    sample = take_sample(store, "validation", 32)

    class Source:
        def generate(self, parameters, seed):
            return sample.frames.images

    seeing = judge(Source(), sample, 0)  # pyright: ignore
    assert seeing["psnr"] == 100.0 and seeing["own_frame"] == 1.0
    blind = Source()
    blind.generate = lambda parameters, seed: sample.frames.images.roll(7, 0)  # type: ignore
    assert judge(blind, sample, 0)["own_frame"] < 0.8  # pyright: ignore


def test_generator_without_the_two_keys_is_refused(store, tmp_path):
    with pytest.raises(RacinesError, match="mean-image has no conditioning and injection"):
        run_ablation(MeanImage, MeanImageConfig(), store, Run(tmp_path))


def test_command_trains_judges_and_prints(workplace, monkeypatch):
    """On phantom frames, as a user types it; a second call reads what the first left."""
    monkeypatch.chdir(workplace)
    settings = {"width": 2, "discriminator_width": 2, "latent": 4, "embedding": 4}
    training = {"ema": 0.0, "precision": "fp32", "batch_size": 16}
    settings |= {"learning_rate": 0.03, "training": training}
    params = {"seed": 0, "generators": {"cgan": settings}}
    (workplace / "params.yaml").write_text(yaml.safe_dump(params))
    words = ["study", "conditioning", "cgan", "--images", "64", "--frames", "20"]
    printed = CliRunner().invoke(app, words)
    assert printed.exit_code == 0, printed.output
    assert "own_frame" in printed.stdout and "euler" in printed.stdout
    again = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert [row["name"] for row in again["variants"]] == NAMES
    assert again["config"]["training"]["images"] == 64
    assert (workplace / "models/runs/conditioning-cgan/euler-norm/samples.png").is_file()
