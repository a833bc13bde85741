"""Scores beyond likeness: neighbours, poses, diversity, memorisation, and what is refused."""

import json

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.judges.pose.regressor import PoseConfig
from racines_models.sample import draw, evenly, take_sample
from racines_models.scores import diversity, scoring
from racines_models.scores.diversity import FRAMES, scanned_again, spread
from racines_models.scores.metrics import Neighbourhoods
from racines_models.scores.scoring import ScoresConfig, score
from racines_models.statistics import median_interval
from tests.models.labelled import LabelledStore, Replay
from tests.models.scores.test_scores import COUNT, QUICK, Coarse, Noise


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(scoring, "InceptionFeatures", Coarse)


@pytest.fixture(scope="module")
def labelled():
    return LabelledStore(trajectories=20, length=12)


class KnownPose:
    """Reads the pose of the true image; one turned upside down is 10 mm off."""

    config = PoseConfig()
    settings = {"id": "known", "sha256": None}

    def __init__(self, store):
        self.store = store
        self.rows = {image.numpy().tobytes(): i for i, image in enumerate(store.images)}

    def predict(self, images):
        found, off = [], []
        for image in images:
            row = self.rows.get(image.numpy().tobytes())
            off.append(0.01 if row is None else 0.0)
            found.append(self.rows[image.flip(0).numpy().tobytes()] if row is None else row)
        pose = parameters_to_pose(self.store.parameters[found])
        return pose._replace(position=pose.position + torch.tensor(off)[:, None] / 3**0.5)


class Upside:
    """Every third image is upside down."""

    def __init__(self, store):
        self.store = store

    def generate(self, parameters, seed):
        row = torch.cdist(parameters, self.store.parameters).argmin(1)
        images = self.store.images[row].clone()
        images[row % 3 == 0] = images[row % 3 == 0].flip(1)
        return images


def figures(generator, store, **options):
    return score(generator, store, QUICK, "any", **options).content["metrics"]


def test_poses_are_told_as_medians_beside_those_of_the_truth():
    labelled = LabelledStore(trajectories=20, length=13)  # its sample meets every view
    content = score(Upside(labelled), labelled, QUICK, "any", pose=KnownPose(labelled)).content
    metrics = content["metrics"]
    sample = take_sample(labelled, "test", COUNT)
    errors = np.where(sample.frames.index.numpy() % 3 == 0, 10.0, 0.0)
    expected = median_interval(errors, sample.trajectory)
    told = metrics["pose_error_mm"]
    assert told["value"] == pytest.approx(expected.value, abs=1e-3)
    assert told["high"] == pytest.approx(expected.high, abs=1e-3)
    assert (
        told["n"] == COUNT and told["unit"] == "mm" and "Woodruff" in told["settings"]["interval"]
    )
    assert metrics["pose_error_mm_truth"]["value"] == pytest.approx(0.0, abs=1e-3)
    assert metrics["pose_error_deg"]["value"] < 0.1
    assert 0 < metrics["pose_error_mm_view"]["n"] == int((sample.frames.views != 5).sum()) < COUNT
    assert content["extractors"]["pose"] == KnownPose.settings
    assert not any("pose" in name for name in figures(Upside(labelled), labelled))
    json.dumps(content, allow_nan=False)


def test_errors_of_several_seeds_are_pooled_and_n_counts_frames(labelled):
    class Seeded(Upside):
        def draw_frames(self, frames, seed):
            images = self.store.images[frames.index]
            return images.flip(1) if seed else images

    def told(seeds):
        return figures(Seeded(labelled), labelled, pose=KnownPose(labelled), seeds=seeds)

    assert told([0])["pose_error_mm"]["value"] == pytest.approx(0.0, abs=1e-3)
    both = told([0, 1])["pose_error_mm"]
    assert both["value"] == pytest.approx(5.0, abs=1e-3) and both["n"] == COUNT


def test_neighbours_are_those_of_each_feature_space(labelled):
    generator = Replay(labelled, 0.2)
    grader = Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125, bf16=False))
    scores = score(generator, labelled, QUICK, "any", grader)
    metrics, truth = scores.content["metrics"], scores.sample.frames.images
    for suffix, embed in (("", Coarse()), ("_grader", lambda x: grader.judge(x)[2])):
        expected = Neighbourhoods(embed(truth), embed(scores.images)).figures()
        for name, value in expected.items():
            told = metrics[f"{name}{suffix}"]
            assert told["value"] == pytest.approx(value) and told["n"] == COUNT
            assert told["low"] <= told["value"] <= told["high"] and told["settings"]["k"] == 5
    assert metrics["coverage"]["high"] <= 1.0
    few = score(generator, labelled, ScoresConfig(samples=5, speed=False), "any")
    assert "precision" not in few.content["metrics"] and "kid" in few.content["metrics"]


def test_diversity_is_the_difference_of_two_draws_of_a_pose(labelled):
    assert figures(Replay(labelled), labelled)["diversity"]["value"] == 0.0
    told = figures(Noise(labelled), labelled)["diversity"]
    frames = take_sample(labelled, "test", COUNT).frames
    pair = [draw(Noise(labelled), frames, seed).double() for seed in (0, 1)]
    expected = (pair[0] - pair[1]).square().mean((1, 2)).sqrt().mean()
    assert told["value"] == pytest.approx(float(expected), rel=1e-5)
    assert told["unit"] == "gray levels" and told["n"] == COUNT
    same = figures(Noise(labelled), labelled, seeds=[0, 1])["diversity"]
    assert same["value"] == pytest.approx(told["value"])
    three = figures(Noise(labelled), labelled, seeds=[0, 1, 2])["diversity"]
    assert three["settings"]["draws"] == 3
    assert three["value"] == pytest.approx(told["value"], rel=0.02)
    assert evenly(1000, FRAMES).tolist() == [1000 * i // 64 for i in range(64)]


def test_images_made_beforehand_have_diversity_only_across_their_seeds(labelled):
    class Stored:
        def draw_frames(self, frames, seed):
            return labelled.images[frames.index] + seed

    assert "diversity" not in figures(Stored(), labelled, seeds=[3])
    assert figures(Stored(), labelled, seeds=[3, 5])["diversity"]["value"] == pytest.approx(2.0)


def test_only_a_phantom_can_be_scanned_again(labelled, monkeypatch, tmp_path):
    assert "diversity_truth" not in figures(Replay(labelled), labelled)
    from racines_data.phantom import model

    calls = []

    def shared_phantom(config, device):
        calls.append(config)
        return Noise(labelled)

    monkeypatch.setattr(diversity, "recorded_phantom", lambda manifest: "its phantom")
    monkeypatch.setattr(model, "shared_phantom", shared_phantom)
    metrics = figures(Noise(labelled), labelled, cache=tmp_path)
    frames = take_sample(labelled, "test", COUNT).frames
    expected = spread([draw(Noise(labelled), frames, seed) for seed in (0, 1)]).mean()
    told = metrics["diversity_truth"]
    assert told["value"] == pytest.approx(float(expected), rel=1e-6)
    assert told["settings"]["source"] == "phantom" and calls == ["its phantom"]
    again = scanned_again(labelled, frames, tmp_path)
    assert again is not None and float(again.mean()) == pytest.approx(told["value"])
    assert len(calls) == 1


def test_copies_of_training_images_are_told(labelled):
    train = labelled.images[labelled.split_indices("train")]

    class Copies:
        def generate(self, parameters, seed):
            own = torch.cdist(parameters, labelled.parameters).argmin(1)
            copied = train[own % len(train)]
            return torch.where((own % 2 == 0).view(-1, 1, 1), copied, 255 - labelled.images[own])

    metrics = figures(Copies(), labelled)
    rows = take_sample(labelled, "test", COUNT).frames.index
    share = float((rows % 2 == 0).double().mean())
    assert metrics["copies"]["value"] == pytest.approx(share)
    assert metrics["copies_truth"]["value"] == 0.0
    assert metrics["nearest_train_truth"]["value"] > diversity.COPY


def test_the_nearest_training_image_is_found_among_many(labelled):
    rows = labelled.split_indices("train")
    train, queries = labelled.images[rows], labelled.images[labelled.split_indices("test")][:9]
    summaries = diversity.summarise_train(labelled)
    found = diversity.nearest_train(queries, labelled, summaries)
    gaps = queries[:, None].double() - train[None].double()
    expected = gaps.square().mean((2, 3)).sqrt().amin(1)
    # The search is by block means: where it does not find the nearest, it finds one as near.
    assert torch.allclose(found.double(), expected, rtol=0.02)
    shifted = train[:6] + 1
    assert diversity.nearest_train(shifted, labelled, summaries).tolist() == [1.0] * 6


def test_what_is_known_of_the_truth_is_kept(labelled, tmp_path, monkeypatch):
    first = figures(Replay(labelled, 0.1), labelled, cache=tmp_path)
    monkeypatch.setattr(diversity, "summarise_train", None)
    Coarse.calls = 0
    assert figures(Replay(labelled, 0.1), labelled, cache=tmp_path) == first
    assert Coarse.calls == 1  # of the drawn images alone


class Fixed:
    def __init__(self, change):
        self.change = change

    def generate(self, parameters, seed):
        images = torch.arange(128).repeat(len(parameters), 128, 1) + parameters[:, :1, None].abs()
        return self.change(images)


REFUSALS = {
    "all black": lambda x: torch.zeros_like(x).byte(),
    "constant": lambda x: torch.full_like(x, 90).byte(),
    "black.* 0-1 images": lambda x: (x / 255).byte(),
    "images lie in 0-1": lambda x: (x / 100).clamp(0, 1).byte(),
    "only 3 gray levels": lambda x: (x / 64 - 1).round().long().byte(),
    "NaN": lambda x: torch.full_like(x, torch.nan),
    "float32": lambda x: x.float(),
    "int64": lambda x: x.long(),
    rf"shape \({COUNT}, 64, 128\)": lambda x: x.byte()[:, ::2],
    rf"shape \({COUNT}, 1, 128, 128\)": lambda x: x.byte().unsqueeze(1),
    f"no .* tensor of {COUNT}": lambda x: x.byte()[1:],
    "near-constant": lambda x: torch.cat([torch.full_like(x[:-9], 9), x[-9:]]).byte(),
}


@pytest.mark.parametrize("words", REFUSALS)
def test_what_cannot_be_scored_is_refused_with_its_reason(labelled, words):
    with pytest.raises(RacinesError, match=words):
        score(Fixed(REFUSALS[words]), labelled, QUICK, "fixed")
