"""The same images get the same scores by every road: entry point, class, predictions, ONNX."""

import json

import onnx
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import read_json
from racines_models.registry import open_generator
from racines_models.sample import draw, take_sample
from racines_models.scores import scoring
from tests.models.scores.test_scores import Coarse

FIGURES = ("ssim", "psnr", "fid", "kid", "distinct")


@pytest.fixture
def here(workplace, monkeypatch):
    monkeypatch.chdir(workplace)
    # The extractor is the same by all roads; the true one would take most of this file's time.
    monkeypatch.setattr(scoring, "InceptionFeatures", Coarse)
    return workplace


def invoke(*words: str) -> dict:
    result = CliRunner().invoke(app, [*words, "--json"])
    if result.exception:
        raise result.exception
    return json.loads(result.stdout)


def scores(spec: str, *more: str) -> dict:
    return invoke("eval", "generator", spec, "--no-grader", "--force", *more)


def figures(content: dict) -> dict:
    return {name: content["metrics"][name] for name in FIGURES}


@pytest.mark.thorough
def test_every_road_gives_the_same_scores(here):
    invoke("train", "generator", "vae-gan", "--device", "cpu")
    by_name = scores("vae-gan")
    by_class = scores("racines_models.generators.vae_gan:VaeGan", "--run", "models/runs/vae-gan")
    assert figures(by_name) == figures(by_class)

    invoke("export", "predictions", "vae-gan", "--out", "mine.parquet")
    by_file = scores("mine.parquet")
    assert by_file["generator"] == "vae-gan" and list(by_file["weights"]) == ["mine.parquet"]
    assert figures(by_file) == figures(by_name)
    read_json(here / "models/runs/scores/vae-gan.json", "generator-scores")

    made = invoke("export", "generator", "vae-gan", "--out", "mine.onnx")
    assert made["bytes"] == (here / "mine.onnx").stat().st_size
    by_onnx = scores("mine.onnx")
    assert list(by_onnx["weights"]) == ["mine.onnx"]
    store = open_store(here / "data/racines")
    frames = take_sample(store, "test", 16).frames
    drawn = [draw(open_generator(spec), frames, 0) for spec in ("vae-gan", "mine.onnx")]
    apart = (drawn[0].int() - drawn[1].int()).abs()
    assert apart.max() <= 1 and (apart > 0).sum() <= 30  # of 262,144
    if not apart.any():
        assert figures(by_onnx) == figures(by_name)
    for name, figure in figures(by_onnx).items():
        assert figure["value"] == pytest.approx(by_name["metrics"][name]["value"], rel=1e-4)

    # The images of the ONNX file, handed in as predictions, score exactly as the file.
    invoke("export", "predictions", "mine.onnx", "--out", "onnx.parquet")
    assert figures(scores("onnx.parquet")) == figures(by_onnx)


def test_mean_image_scores_the_same_by_all_four(here):
    invoke("train", "generator", "mean-image")
    invoke("export", "generator", "mean-image", "--out", "mean.onnx")
    invoke("export", "predictions", "mean-image", "--out", "mean.parquet")
    roads = ("mean-image", "racines_models.generators.mean_image:MeanImage", "mean.onnx")
    first, *others = (figures(scores(road)) for road in (*roads, "mean.parquet"))
    assert all(other == first for other in others)


def test_refusals_reach_the_command_line(here):
    invoke("export", "poses", "--out", "poses.parquet")
    for spec, message in (
        ("poses.parquet", "a poses file"),
        ("absent.parquet", "no such file"),
        ("absent.onnx", "no such file"),
    ):
        with pytest.raises(RacinesError, match=message):
            scores(spec)
    result = CliRunner().invoke(app, ["export", "generator", "vae-gan", "--out", "x.pt"])
    assert result.exit_code == 2 and ".onnx" in result.output


def test_predictions_of_another_sample_are_refused(here):
    invoke("train", "generator", "mean-image")
    invoke("export", "predictions", "mean-image", "--out", "mean.parquet", "--samples", "8")
    with pytest.raises(RacinesError, match="another sample of frames"):
        scores("mean.parquet")
    assert figures(scores("mean.parquet", "--samples", "8"))["ssim"]["n"] == 8
    with pytest.raises(RacinesError, match="made for split 'test', not 'validation'"):
        scores("mean.parquet", "--samples", "8", "--split", "validation")
    assert len(pq.read_table("mean.parquet")) == 8


def test_the_exported_file_is_one_valid_model(here):
    invoke("train", "generator", "mean-image")
    invoke("export", "generator", "mean-image", "--out", "folder/mean.onnx")
    assert [path.name for path in (here / "folder").iterdir()] == ["mean.onnx"]
    onnx.checker.check_model("folder/mean.onnx", full_check=True)
