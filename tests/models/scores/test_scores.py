import json

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.pictures import pick_columns, write_strip
from racines_models.sample import check_drawn, draw, take_sample
from racines_models.scores import scoring
from racines_models.scores.features import features_of_sets, reference_features
from racines_models.scores.metrics import psnr, ssim
from racines_models.scores.scoring import ScoresConfig, score
from racines_models.statistics import mean_interval
from tests.models.labelled import LabelledStore, Replay


class Coarse:
    """A stand-in for Inception: mean gray of 8 x 8 blocks."""

    settings = {"id": "coarse", "sha256": None, "layer": "-", "resizer": "-", "range": "-"}
    calls = 0

    def __init__(self, device="cpu"):
        pass

    def __call__(self, images, progress=None):
        Coarse.calls += 1
        return torch.nn.functional.avg_pool2d(images.unsqueeze(1) / 255, 16).flatten(1)


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(scoring, "InceptionFeatures", Coarse)


@pytest.fixture(scope="module")
def labelled():
    return LabelledStore(trajectories=20, length=12)


COUNT = 24
"""Frames of a sample: four of each of the six trajectories."""
QUICK = ScoresConfig(samples=COUNT, speed=False)


def test_every_number_has_n_an_interval_and_its_settings(labelled, coarse):
    content = score(Replay(labelled, 0.2), labelled, QUICK, "replay").content
    for name in ("ssim", "psnr", "fid", "kid"):
        metric = content["metrics"][name]
        assert metric["low"] < metric["value"] < metric["high"], name
        assert metric["n"] == COUNT and metric["settings"]["units"] == 6
    assert content["dataset"]["digest"] == labelled.manifest["digest"]
    assert content["dataset"]["split"] == "test"
    assert content["extractors"]["inception"]["id"] == "coarse"
    assert content["metrics"]["fid"]["settings"]["features"] == "coarse"
    json.dumps(content, allow_nan=False)


def test_values_are_those_of_the_sampled_frames(labelled, coarse):
    generator = Replay(labelled, 0.2)
    scores = score(generator, labelled, QUICK, "replay")
    frames = scores.sample.frames
    drawn = generator.generate(frames.parameters, 0)
    assert torch.equal(scores.images, drawn)
    for name, metric in (("ssim", ssim), ("psnr", psnr)):
        expected = float(metric(drawn, frames.images).double().mean())
        assert scores.content["metrics"][name]["value"] == pytest.approx(expected)
    again = score(generator, labelled, QUICK, "replay").content["metrics"]
    assert again == scores.content["metrics"]


def test_a_perfect_generator_reaches_the_limits(labelled, coarse):
    metrics = score(Replay(labelled), labelled, QUICK, "replay").content["metrics"]
    assert metrics["ssim"]["value"] == pytest.approx(1.0)
    assert metrics["psnr"]["value"] == 100.0
    assert metrics["fid"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert metrics["distinct"]["value"] == 1.0


def test_worse_images_score_worse(labelled, coarse):
    good, bad = (
        score(Replay(labelled, darker), labelled, QUICK, "replay").content["metrics"]
        for darker in (0.1, 0.5)
    )
    assert good["ssim"]["value"] > bad["ssim"]["value"]
    assert good["psnr"]["value"] > bad["psnr"]["value"]
    assert good["fid"]["value"] < bad["fid"]["value"]
    assert good["kid"]["value"] < bad["kid"]["value"]


class Noise:
    """Noise on the true frame; its level is fixed, its pattern is the seed's."""

    def __init__(self, store):
        self.store = store

    def generate(self, parameters, seed):
        row = torch.cdist(parameters, self.store.parameters).argmin(1)
        patterns = [
            torch.randint(0, 40, (128, 128), generator=torch.Generator().manual_seed(int(s)))
            for s in seed
        ]
        return (self.store.images[row].int() + torch.stack(patterns)).clamp(0, 255).byte()


def test_seeds_are_averaged_and_n_counts_frames(labelled, coarse):
    generator = Noise(labelled)
    one, two = (
        score(generator, labelled, QUICK, "noise", seeds=[seed]).content["metrics"]
        for seed in (3, 4)
    )
    both = score(generator, labelled, QUICK, "noise", seeds=[3, 4]).content
    assert one["psnr"]["value"] != two["psnr"]["value"]
    for name in ("psnr", "fid", "kid"):
        mean = (one[name]["value"] + two[name]["value"]) / 2
        assert both["metrics"][name]["value"] == pytest.approx(mean)
    assert both["metrics"]["psnr"]["n"] == COUNT and both["seeds"] == [3, 4]


def test_a_grader_adds_agreement_with_the_truth_and_its_own_ceiling(labelled, coarse):
    grader = Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125, bf16=False))
    metrics = score(Replay(labelled), labelled, QUICK, "replay", grader).content["metrics"]
    sample = take_sample(labelled, "test", COUNT)
    label, grade, _ = grader.judge(sample.frames.images)
    right = float((label == sample.frames.views).double().mean())
    assert metrics["view_agreement"]["value"] == metrics["view_agreement_truth"]["value"] == right
    chosen = sample.frames.views != 5
    error = (grade - sample.frames.grades).abs()[chosen].double().mean()
    assert metrics["grade_error"]["value"] == pytest.approx(float(error))
    assert metrics["grade_error"]["n"] == int(chosen.sum())
    assert {"fid_grader", "kid_grader", "grade_agreement"} <= set(metrics)


def test_unlabelled_data_have_no_agreement(coarse):
    store = LabelledStore()
    store.views[:], store.grades[:] = -1, torch.nan
    grader = Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125, bf16=False))
    metrics = score(Replay(store), store, QUICK, "replay", grader).content["metrics"]
    assert "fid_grader" in metrics
    assert not {"view_agreement", "grade_error", "grade_error_all"} & set(metrics)


def test_one_trajectory_gives_values_without_intervals(coarse):
    store = LabelledStore(trajectories=1, length=12)
    store._splits["test"] = [0, 12]
    metrics = score(Replay(store, 0.1), store, QUICK, "replay").content["metrics"]
    assert metrics["ssim"]["value"] < 1 and metrics["ssim"]["low"] is None
    assert metrics["fid"]["value"] > 0 and metrics["fid"]["high"] is None


def test_speed_is_reported_at_batch_1_and_64(labelled, coarse):
    metrics = score(Replay(labelled), labelled, ScoresConfig(samples=8), "replay").content
    for batch in (1, 64):
        assert metrics["metrics"][f"images_per_second_{batch}"]["value"] > 0


def test_images_made_beforehand_are_found_by_frame_and_have_no_speed(labelled, coarse):
    class Stored:
        def draw_frames(self, frames, seed):
            return labelled.images[frames.index] + seed

    config = ScoresConfig(samples=8)
    scores = score(Stored(), labelled, config, "stored", seeds=[0])
    assert scores.content["metrics"]["psnr"]["value"] == 100.0
    assert not any("per_second" in name for name in scores.content["metrics"])
    other = score(Stored(), labelled, config, "stored", seeds=[9])
    assert torch.equal(other.images, scores.images + 9)


def test_the_sample_spreads_over_all_trajectories(labelled):
    sample = take_sample(labelled, "test", 30)
    rows = labelled.split_indices("test")
    assert set(sample.frames.index.tolist()) <= set(rows.tolist())
    assert len(set(sample.frames.index.tolist())) == 30
    _, counts = np.unique(sample.trajectory, return_counts=True)
    assert counts.tolist() == [5] * 6
    assert len(take_sample(labelled, "test", 10_000).trajectory) == 72
    assert take_sample(labelled, "test", 30).digest == sample.digest
    assert take_sample(labelled, "test", 29).digest != sample.digest


def test_an_empty_split_is_refused():
    store = LabelledStore()
    store._splits["test"] = [0, 0]
    with pytest.raises(RacinesError, match="split test has 0 frames.*scores.split"):
        take_sample(store, "test", 10)


def test_a_frame_is_drawn_alike_whatever_is_drawn_with_it(labelled):
    few, many = (take_sample(labelled, "test", n).frames for n in (24, 72))
    drawn = dict(zip(many.index.tolist(), draw(Noise(labelled), many, 1), strict=True))
    common = [i for i, row in enumerate(few.index.tolist()) if row in drawn]
    assert len(common) > 10
    images = draw(Noise(labelled), few, 1)
    assert all(torch.equal(images[i], drawn[int(few.index[i])]) for i in common)


def test_images_that_cannot_be_scored_are_refused(labelled):
    good = labelled.images[:4]
    assert check_drawn(good) is good
    faults = {
        "NaN": torch.full((4, 128, 128), torch.nan),
        "uint8": good.float(),
        "0-1": (good > 100).to(torch.uint8),
        "constant": torch.full_like(good, 90),
        "near-constant": torch.full_like(good, 90).index_fill_(1, torch.tensor([0]), 92),
        "shape": good[:, :64, :64],
    }
    for words, images in faults.items():
        with pytest.raises(RacinesError, match=words):
            check_drawn(images)


def test_missing_images_are_refused(labelled):
    class Short(Replay):
        def generate(self, parameters, seed):
            return super().generate(parameters[1:], seed)

    with pytest.raises(RacinesError, match="returned no"):
        score(Short(labelled), labelled, QUICK, "short")


def test_reference_features_are_kept_by_content_and_settings(labelled, tmp_path):
    images = labelled.images[:6]
    Coarse.calls = 0
    first = reference_features(Coarse(), images, ["digest"], tmp_path)
    assert torch.equal(reference_features(Coarse(), images, ["digest"], tmp_path), first)
    assert Coarse.calls == 1
    reference_features(Coarse(), images, ["other data"], tmp_path)
    assert Coarse.calls == 2
    other = Coarse()
    other.settings = {**Coarse.settings, "resizer": "other"}
    reference_features(other, images, ["digest"], tmp_path)
    assert Coarse.calls == 3 and len(list(tmp_path.iterdir())) == 3
    for path in tmp_path.iterdir():
        path.write_bytes(b"broken")
    assert torch.equal(reference_features(Coarse(), images, ["digest"], tmp_path), first)
    assert Coarse.calls == 4


def test_the_strip_shows_the_best_of_each_view(labelled, tmp_path):
    rows = labelled.split_indices("test")
    views, grades = labelled.views[rows], labelled.grades[rows]
    columns = pick_columns(views, grades)
    assert len(set(columns.tolist())) == 8 and views[columns[:5]].tolist() == [0, 1, 2, 3, 4]
    assert float(grades[columns[0]]) == float(grades[views == 0].max())
    unknown = pick_columns(torch.full((72,), -1), torch.full((72,), torch.nan))
    assert len(set(unknown.tolist())) == 8
    assert pick_columns(views[:3], grades[:3]).sort().values.tolist() == [0, 1, 2]
    strip = labelled.images[rows][columns]
    write_strip(tmp_path / "strip.png", [strip, strip // 2], gap=2)
    from PIL import Image

    drawn = np.asarray(Image.open(tmp_path / "strip.png"))
    assert drawn.shape == (2 * 128 + 2, 8 * 130 - 2)
    assert np.array_equal(drawn[:128, 130:258], strip[1].numpy())
    assert np.array_equal(drawn[130:, :128], strip[0].numpy() // 2)


def test_intervals_of_scores_leave_out_trajectories(labelled, coarse):
    scores = score(Replay(labelled, 0.2), labelled, QUICK, "replay")
    values = psnr(scores.images, scores.sample.frames.images).double().numpy()
    expected = mean_interval(values, scores.sample.trajectory)
    metric = scores.content["metrics"]["psnr"]
    assert (metric["low"], metric["high"]) == (expected.low, expected.high)


def test_an_image_drawn_twice_is_looked_at_once():
    seen = []

    def mean(images, progress=None):
        seen.append(len(images))
        return images.float().mean((1, 2)).unsqueeze(1)

    images = torch.arange(5).view(5, 1, 1).expand(-1, 128, 128).byte()
    sets = [images[[3, 1, 3]], images[[1, 0]], images[[2, 2, 2, 4]]]
    told = []
    features = features_of_sets(mean, sets, told.append)
    assert seen == [5] and sum(told) == 4
    for each, drawn in zip(features, sets, strict=True):
        assert torch.equal(each, mean(drawn))
