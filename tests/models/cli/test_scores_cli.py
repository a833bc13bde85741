"""`racines train grader`, `eval generator` and `study realism`, as a user types them."""

import json

import polars as pl
import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import read_json
from racines_models.judges.grader.model import Grader
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.scores import scoring
from racines_models.scores.features import InceptionFeatures
from tests.models.scores.test_scores import Coarse
from tests.models.studies.test_realism import png

STAGE = {"epochs": 1}
PARAMS = {
    "board": "tiny",
    "seed": 3,
    "grader": {
        "input_size": 32,
        "width": 0.125,
        "bf16": False,
        "view_stage": STAGE,
        "grade_stage": STAGE,
    },
    "pose": {"width": 0.125, "training": {"images": 96, "batch_size": 32, "warmup_images": 0}},
    "generators": {"nearest-pose": {"frames": 50}},
    "scores": {"samples": 8},
    "realism": {"frames": 4, "grade": 0.0, "splits": 2},
}


@pytest.fixture
def here(workplace, monkeypatch):
    (workplace / "params.yaml").write_text(yaml.safe_dump(PARAMS))
    monkeypatch.chdir(workplace)
    return workplace


@pytest.fixture(scope="module", autouse=True)
def each_image_once():
    """Look at each image once in this file: its features do not depend on its batch."""
    look, known = InceptionFeatures.__call__, {}

    def remember(self, images, progress=None):
        keys = [image.numpy().tobytes() for image in images]
        new = [i for i, key in enumerate(keys) if key not in known]
        if new:
            known.update(zip((keys[i] for i in new), look(self, images[new]), strict=True))
        if progress is not None:
            progress(len(images))
        return torch.stack([known[key] for key in keys])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InceptionFeatures, "__call__", remember)
        yield


def invoke(*words: str) -> str:
    result = CliRunner().invoke(app, [*words])
    if result.exception:
        raise result.exception
    return result.stdout


def refused(*words: str) -> str:
    with pytest.raises(RacinesError) as caught:
        invoke(*words)
    return str(caught.value)


@pytest.mark.thorough
def test_grader_then_generator_then_scores(here):
    metrics = json.loads(invoke("train", "grader", "--json"))
    store = open_store(here / "data/racines")
    assert metrics["dataset"]["digest"] == store.manifest["digest"] and metrics["seed"] == 3
    assert metrics["metrics"]["view_accuracy"]["n"] == len(store.split_indices("test"))
    grader = Grader.load(here / "models/runs/grader")
    assert grader.config.input_size == 32

    invoke("train", "generator", "nearest-pose", "--json")
    content = json.loads(invoke("eval", "generator", "nearest-pose", "--json"))
    path = here / "models/runs/scores/nearest-pose.json"
    assert read_json(path, "generator-scores") == content
    assert content["dataset"]["board"] == "tiny" and content["metrics"]["fid"]["n"] == 8
    assert content["extractors"]["grader"]["sha256"] == grader.sha256
    assert list(content["weights"]) == ["model.safetensors"]
    assert path.with_suffix(".png").is_file()

    invoke("eval", "generator", "nearest-pose", "--json")  # the same may be written again
    fewer = ("eval", "generator", "nearest-pose", "--no-grader", "--samples", "6")
    before = path.read_bytes()
    assert "--force to replace it" in refused(*fewer) and path.read_bytes() == before
    shown = invoke(*fewer, "--force")
    assert "fid" in shown and "view_agreement" not in shown
    assert json.loads(path.read_text())["metrics"]["fid"]["n"] == 6


def test_a_pose_regressor_is_used_where_there_is_one(here, monkeypatch):
    monkeypatch.setattr(
        scoring, "InceptionFeatures", Coarse
    )  # it is asked five times, beside the point
    metrics = json.loads(invoke("train", "pose", "--json"))
    regressor = PoseRegressor.load(here / "models/runs/pose")
    assert regressor.config.width == 0.125 and metrics["training"]["images"] == 96
    assert metrics["seed"] == 3 and metrics["metrics"]["pose_error_mm"]["value"] > 0
    invoke("train", "generator", "nearest-pose", "--json")
    words = (
        "eval",
        "generator",
        "nearest-pose",
        "--no-grader",
        "--samples",
        "8",
        "--json",
        "--force",
    )
    content = json.loads(invoke(*words))
    assert content["extractors"]["pose"]["sha256"] == regressor.sha256
    assert content["metrics"]["pose_error_mm"]["n"] == 8
    # The phantom of this dataset was scanned again.
    assert content["metrics"]["diversity_truth"]["value"] > 0
    assert "pose_error_mm" not in json.loads(invoke(*words, "--no-pose"))["metrics"]
    (here / "models/runs/pose").rename(here / "elsewhere")
    assert "pose_error_mm" not in json.loads(invoke(*words))["metrics"]
    again = json.loads(invoke(*words, "--pose", "elsewhere"))["metrics"]
    assert again["pose_error_mm"]["value"] == content["metrics"]["pose_error_mm"]["value"]
    assert "train pose" in refused(*words, "--pose", "nowhere")


@pytest.mark.thorough
def test_truth_against_truth(here):
    words = ("study", "floor", "--n", "4", "--splits", "2")
    content = json.loads(invoke(*words, "--n", "6", "--json"))
    assert [row["n"] for row in content["rows"]["inception"]] == [4, 6]
    assert json.loads((here / "models/runs/floor.json").read_text()) == content
    assert (here / "models/runs/floor.png").is_file()
    shown = invoke(*words)
    assert "inception, n = 4: FID" in shown
    assert "fewer than the smallest" in refused("study", "floor", "--n", "4000")


def test_refusals_name_the_remedy(here):
    assert "train grader" in refused("eval", "generator", "nearest-pose")
    assert "data build" in refused("train", "grader", "--data", "nowhere")
    assert "use --fresh" in refused("train", "grader", "--resume")
    (here / "params.yaml").write_text("grader: {input_size: 50}")
    assert "grader.input_size 50" in refused("train", "grader")
    (here / "params.yaml").write_text("scores: {sample: 50}")
    assert "scores.sample: unknown key" in refused("eval", "generator", "nearest-pose")


def test_realism_compares_or_says_loudly_that_it_did_not(here):
    told = refused("study", "realism")
    assert "NOT COMPARED" in told and "--real" in told
    assert "absent.parquet: no such file" in refused("study", "realism", "--real", "absent.parquet")
    invoke("study", "realism", "--optional", "--real", "absent.parquet")
    report = here / "models/runs/realism.json"
    of_many = here / "models/runs/realism-multi_phantom.json"
    for path, config in ((report, "frames"), (of_many, "multi_phantom")):
        told = json.loads(path.read_text())
        assert told == {
            "schema": "racines.realism/1",
            "compared": False,
            "config": config,
            "reason": "the named file of real frames is absent",
        }

    store = open_store(here / "data/racines")
    images = [png(image.numpy()) for image in store.images[store.views == 0][:8]]
    patients = [f"patient{i // 2}" for i in range(len(images))]
    pl.DataFrame({"patient": patients, "image": images}).write_parquet(here / "real.parquet")
    both = json.loads(invoke("study", "realism", "--real", "real.parquet", "--json"))
    content = both["frames"]
    assert json.loads(report.read_text()) == content and content["config"] == "frames"
    assert content["compared"] and content["figures"]["kid"]["phantom"]["value"] is not None
    assert report.with_suffix(".png").is_file()
    many = json.loads(of_many.read_text())
    assert many == both["multi_phantom"] and not many["compared"]
    assert many["reason"] == "the dataset has no config multi_phantom"
    assert not of_many.with_suffix(".png").exists()


def test_ablation_says_what_it_lacks(here):
    assert "NOT COMPARED" in refused("study", "ablation")
    told = refused("study", "ablation", "--real", "absent.parquet")
    assert "absent.parquet: no such file" in told
