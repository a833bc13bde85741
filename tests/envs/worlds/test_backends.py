"""Generators, however they come, and that the parts of an environment are of one dataset."""

import json
import shutil
from dataclasses import replace
from typing import Any

import gymnasium
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.apis.torchrl_env import ScanEnv
from racines_envs.worlds.backends import open_source, source_weights
from racines_envs.worlds.making import check_datasets, make_core, trained_on
from racines_models.exchange.onnx.generator import export_generator
from racines_models.generators.mean_image import MeanImage
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from racines_models.training.objective import Training
from tests.conftest import ROOT
from tests.envs.fakes import FakeGrader

SETTINGS: dict[str, Any] = {"observation": "image", "reward": "oracle"}
ONE = {"source": "phantom", "version": "1.0.0", "digest": "a" * 64, "recipe_digest": "r" * 64}
REBUILT = ONE | {"digest": "b" * 64}
OTHER = {"source": "phantom", "version": "1.1.0", "digest": "c" * 64, "recipe_digest": "s" * 64}


class Mine(MeanImage):
    """A generator that no package registers."""

    name = "mine"


@pytest.fixture(scope="module")
def runs(tiny_root, tmp_path_factory):
    """Folders of trained generators: models/runs/mean-image, mine."""
    base = tmp_path_factory.mktemp("runs")
    for cls, folder in ((MeanImage, "models/runs/mean-image"), (Mine, "elsewhere")):
        run = Run(base / folder, device="cpu", progress=False)
        run.folder.mkdir(parents=True)
        generator = cls()
        generator.fit(open_store(tiny_root), run)
    return base


def test_a_generator_is_found_whichever_way_it_is_named(runs, phantom, monkeypatch):
    monkeypatch.chdir(runs)
    mean = MeanImage.load(runs / "models/runs/mean-image")
    mine = f"{__name__}:Mine@elsewhere"
    named = ("mean-image", "models/runs/mean-image", "mean-image@models/runs/mean-image", mine)
    for spec in (*named, runs / "models/runs/mean-image", mean):
        core = make_core("SC", 2, backend="generator", generator=spec, phantom=phantom, **SETTINGS)
        assert torch.equal(core.reset(seed=0)["image"], mean.generate(core.parameters, 0)), spec
    assert open_source(mine).name == "mine"


def test_what_sees_no_images_learns_the_same_in_a_generator_and_in_the_phantom(
    runs, phantom, tmp_path
):
    """Motion, forces and truth are the phantom's whatever draws the images."""
    plain = PPOConfig(
        frames=256, envs=8, update_every=128, minibatch=64, epochs=1, hidden=(8, 8),
        validate_every=128, validation_starts=4,
    )  # fmt: skip
    drawn = replace(plain, backend="generator", generator=str(runs / "models/runs/mean-image"))
    for name, config in (("phantom", plain), ("generator", drawn)):
        PPOAgent.train(config, tmp_path / name, phantom=phantom, progress=False)
    one, other = (
        (tmp_path / name / "policy.safetensors").read_bytes() for name in ("phantom", "generator")
    )
    assert one == other


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("nothing", "unknown generator 'nothing': choose one of"),
        ("nearest-pose", "no run folder models/runs/nearest-pose; run `racines train generator ne"),
        ("some/folder", "'some/folder': no run folder or file"),
        ("models", "no trained generator here"),
        ("absent.onnx", "absent.onnx"),
        ("mean-image@absent", "no run folder absent"),
    ],
)
def test_a_generator_that_is_not_there_is_refused_by_name(runs, phantom, monkeypatch, spec, word):
    monkeypatch.chdir(runs)
    with pytest.raises(RacinesError, match=word):
        make_core("SC", backend="generator", generator=spec, phantom=phantom, **SETTINGS)


def test_an_onnx_file_is_a_backend_and_tells_its_dataset(tiny_root, phantom, tmp_path):
    training = Training(images=16, batch_size=8, ema=0.0, sample_every=16, checkpoint_every=16)
    generator = VaeGan(VaeGanConfig(width=4, training=training))
    generator.fit(open_store(tiny_root), Run(tmp_path, device="cpu", progress=False))
    export_generator(generator, tmp_path / "drawn.onnx")
    settings = {"backend": "generator", "phantom": phantom} | SETTINGS
    core = make_core("SC", 2, generator=str(tmp_path / "drawn.onnx"), **settings)
    seen = core.reset(seed=0)["image"]
    same = make_core("SC", 2, generator=tmp_path, **settings).reset(seed=0)["image"]
    assert (seen.int() - same.int()).abs().max() <= 1
    told = trained_on(core.images)
    assert told is not None and told["digest"] == open_store(tiny_root).digest


def test_parts_of_one_dataset_pass_and_others_do_not():
    check_datasets({"a": ONE, "b": REBUILT, "c": None})
    with pytest.raises(RacinesError, match=r"a is from phantom 1\.0\.0 \(aaaaaaaa…\) and b from"):
        check_datasets({"a": ONE, "b": OTHER})
    check_datasets({"a": ONE, "b": OTHER}, "any")
    for wanted in ("1.0.0", "v1.0.0", "phantom-v1.0.0", "aaaaaaaa", "rrrrrrrrrr"):
        check_datasets({"a": ONE}, wanted)
    for wanted in ("1.1.0", "aaaa", "release-v1.0.0"):
        with pytest.raises(RacinesError, match=rf"a is from .*not {wanted}.*data_version='any'"):
            check_datasets({"a": ONE}, wanted)
    with pytest.raises(RacinesError, match="c does not say which dataset"):
        check_datasets({"a": ONE, "c": None}, "1.0.0")


def test_a_generator_of_another_dataset_than_the_recordings_or_the_grader_is_refused(
    runs, phantom, tiny_root, tmp_path
):
    folder = tmp_path / "mean-image"
    shutil.copytree(runs / "models/runs/mean-image", folder)
    settings = {"backend": "generator", "generator": folder, "phantom": phantom} | SETTINGS
    more = settings | {"forces": "fitted", "data": tiny_root}
    make_core("SC", **more)
    version = open_store(tiny_root).manifest["version"]
    make_core("SC", data_version=version, **more)
    with pytest.raises(RacinesError, match=r"dataset .*not 9\.9\.9"):
        make_core("SC", data_version="9.9.9", **more)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"data": OTHER}))
    with pytest.raises(RacinesError, match=r"dataset .* and the generator from phantom 1\.1\.0"):
        make_core("SC", **more)
    make_core("SC", data_version="any", **more)
    make_core("SC", **settings)  # nothing to disagree with


def test_a_grader_in_a_folder_tells_its_dataset(tmp_path):
    config = {"schema": "racines.grader/1", "dataset": ONE}
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert trained_on(tmp_path) == ONE
    (tmp_path / "config.json").write_text(json.dumps({"schema": "racines.grader/1"}))
    assert trained_on(tmp_path) is None
    assert trained_on(FakeGrader()) is None


def test_a_name_without_a_run_is_the_published_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    there = ROOT / "models/weights/vae-gan"
    assert weights_sha256(there).items() <= source_weights("vae-gan").items()
    drawn = open_source("vae-gan", "cpu").generate(torch.zeros(1, 12), 0)
    expected = open_source(f"vae-gan@{there}", "cpu").generate(torch.zeros(1, 12), 0)
    assert torch.equal(drawn, expected)
    assert "no models/runs/vae-gan here: using the published" in capsys.readouterr().err


def test_a_setting_that_is_unknown_is_named_with_the_nearest():
    with pytest.raises(RacinesError, match="unknown setting 'obs': did you mean 'observation'?"):
        gymnasium.make("racines_envs:racines/SC-v0", obs="image")
    with pytest.raises(RacinesError, match="unknown setting 'colour' .known: backend, "):
        ScanEnv("SC", 2, colour="red")
