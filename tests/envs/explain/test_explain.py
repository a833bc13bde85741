"""Attributions: exact where that can be known, better than chance where it should be, and whole."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.explain.maps import (
    areas,
    blur,
    grader_probabilities,
    integrated_gradients,
    overlap,
    plane_points,
    policy_logits,
    random_maps,
    ranks,
    sector_of,
    true_regions,
)
from racines_envs.explain.run import ExplainConfig, explain, write_explanation
from tests.conftest import command
from tests.envs.fakes import FakePhantom

SMALL = ExplainConfig(starts=2, every=3, frames=2, steps=8, random_maps=1)
SECTOR = torch.zeros(128, 128, dtype=torch.bool)
SECTOR[10:110, 20:108] = True
PATCH = (slice(40, 60), slice(50, 70))


CHECKS = ((torch.arange(20)[:, None] + torch.arange(20)) % 2) * 2.0 - 1.0


def texture_judge(images, params):
    """Two outputs: how bright the bright fields of a patch's checkerboard are, and a constant."""
    shown = (images[:, *PATCH][:, CHECKS > 0].mean(1) - 190.0) / 10.0
    return torch.stack([shown, torch.ones_like(shown)], -1)


def some_images(count=3):
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(60, 256, (count, 128, 128), generator=generator)
    return (images * SECTOR).to(torch.uint8)


def agent(tmp_path, observation="image", view="SC"):
    torch.manual_seed(0)
    config = PPOConfig(view=view, observation=observation, hidden=(16, 16))
    actor = make_actor(config)
    nn.init.normal_(actor.head.weight)
    PPOAgent(config, actor.eval()).save(tmp_path, {}, 0)
    return tmp_path


def test_of_a_linear_judge_they_are_weight_times_pixel():
    weight = torch.randn(128, 128, generator=torch.Generator().manual_seed(1))
    images, params = some_images(), torch.zeros(3, 9)

    def judge(x, _):
        value = (x * weight).sum((1, 2))
        return torch.stack([value, -value], -1)

    maps, error = integrated_gradients(judge, images, params, torch.tensor([0, 1, 0]), 4)
    sign = torch.tensor([1.0, -1.0, 1.0]).view(3, 1, 1)
    torch.testing.assert_close(maps, sign * images * weight, rtol=1e-4, atol=1e-3)
    assert float(error.abs().max()) < 0.5  # of sums of some ten thousands


def test_of_a_curved_judge_they_are_complete_and_more_steps_are_better():
    images, params, targets = some_images(), torch.ones(3, 9), torch.zeros(3, dtype=torch.int64)

    def judge(x, given):
        bright = x[:, *PATCH].mean((1, 2)) / 60.0
        return torch.stack([torch.tanh(bright) * given[:, 0], bright], -1)

    exact = judge(images.float(), params)[:, 0]
    maps, error = integrated_gradients(judge, images, params, targets, 50)
    torch.testing.assert_close(maps.sum((1, 2)), exact, rtol=1e-3, atol=1e-3)
    _, coarse = integrated_gradients(judge, images, params, targets, 2)
    assert float(error.abs().max()) < 1e-3 < float(coarse.abs().max())


def test_a_true_map_beats_random_ones_in_deletion_and_insertion_and_lies_where_it_should():
    images, params = some_images(), torch.zeros(3, 9)
    images[:, *PATCH] = (150 + 60 * CHECKS).to(torch.uint8)
    targets = torch.zeros(3, dtype=torch.int64)
    maps, _ = integrated_gradients(texture_judge, images, params, targets, 8)
    for insert, sign in ((False, -1.0), (True, 1.0)):

        def area(drawn, insert=insert):
            return areas(texture_judge, images, params, targets, drawn, SECTOR, insert, True)

        for sigma in (0.0, 4.0):
            noise = [area(random_maps(maps.shape, seed, sigma)).mean() for seed in range(4)]
            assert sign * (area(maps).mean() - np.mean(noise)) > 0.02
        assert (sign * (area(maps) - area(-maps)) > 0).all()
    region = torch.zeros(3, 128, 128, dtype=torch.bool)
    region[:, *PATCH] = True
    hit, chance = overlap(maps.abs(), region, SECTOR)
    assert np.allclose(chance, 400 / 8800) and np.allclose(hit, 200 / 880, atol=0.06)
    hit, chance = overlap(random_maps(maps.shape, 3), region, SECTOR)
    assert np.allclose(hit, chance, atol=0.03)


def test_pixels_outside_the_sector_are_never_taken():
    place = ranks(torch.randn(2, 128, 128), SECTOR)
    assert (place[:, ~SECTOR] == 2.0).all()
    assert sorted(place[0, SECTOR].tolist()) == pytest.approx([i / 8800 for i in range(8800)])


def test_random_maps_are_of_their_seed_and_as_smooth_as_asked():
    shape = torch.Size([2, 128, 128])
    assert torch.equal(random_maps(shape, 1), random_maps(shape, 1))
    assert not torch.equal(random_maps(shape, 1), random_maps(shape, 2))
    rough, smooth = random_maps(shape, 1), random_maps(shape, 1, 4.0)
    assert float(smooth.diff(dim=2).std() / smooth.std()) < 0.3
    assert float(rough.diff(dim=2).std() / rough.std()) > 1.2
    flat = torch.full((1, 32, 32), 7.0)
    torch.testing.assert_close(blur(flat, 3.0), flat)


def test_the_policys_function_is_the_policy_and_has_a_gradient(tmp_path):
    policy = PPOAgent.load(agent(tmp_path, "multimodal"))
    judge = policy_logits(policy)
    images, params = some_images().float().requires_grad_(), torch.rand(3, 9)
    logits = judge(images, params)
    observation = {"image": some_images(), "params": params}
    assert torch.equal(logits.argmax(-1), policy.act(observation, torch.zeros(3)))
    logits[:, 2].sum().backward()
    assert float(images.grad.abs().sum()) > 0


def test_an_agent_that_looks_through_an_encoder_is_explained_down_to_its_pixels():
    class Encoder(nn.Module):
        size = 5

        def __init__(self):
            super().__init__()
            self.sha256 = None
            self.layer = nn.Linear(16, 5)

        def forward(self, images):
            return self.layer(nn.functional.avg_pool2d(images.float(), 32).flatten(1) / 255)

    torch.manual_seed(0)
    encoder = Encoder()
    config = PPOConfig(observation="image", hidden=(16, 16))
    actor = make_actor(config, encoder)
    nn.init.normal_(actor.head.weight)
    judge = policy_logits(PPOAgent(config, actor, encoder))
    images, targets = some_images(), torch.tensor([1, 5, 9])
    maps, error = integrated_gradients(judge, images, torch.zeros(3, 9), targets, 32)
    assert float(maps.abs().sum()) > 0
    assert float(error.abs().max()) < 1e-3


def test_a_graders_function_is_its_probabilities(monkeypatch):
    from racines_models.judges.grader.model import Grader, GraderConfig

    torch.manual_seed(0)
    config = GraderConfig(input_size=32, width=0.125, bf16=False)
    grader = Grader(Grader.build(config, 6), config, temperature=1.7)
    judge = grader_probabilities(grader)
    images = some_images()
    expected, _ = grader.probabilities_and_grade(images)
    torch.testing.assert_close(judge(images.float(), torch.zeros(3, 9)), expected.clone())
    maps, _ = integrated_gradients(judge, images, torch.zeros(3, 9), torch.tensor([0, 1, 2]), 4)
    assert float(maps.abs().sum()) > 0
    with pytest.raises(RacinesError, match="no network"):
        grader_probabilities(object())


@pytest.mark.parametrize("observation", ["image", "multimodal"])
def test_explaining_writes_scores_maps_and_pictures(phantom, tmp_path, observation):
    run = agent(tmp_path / "run", observation)
    result = explain("ppo", run, SMALL, phantom)
    write_explanation(result, tmp_path / "out", pictures=1)
    scores = json.loads((tmp_path / "out/explanation.json").read_text())
    assert scores["schema"] == "racines.explanation/1" and scores["images"] == 4
    figures = scores["metrics"]["policy"]
    assert {"deletion", "insertion_gain_over_smooth_random", "completeness_error"} <= set(figures)
    assert figures["deletion"]["n"] == 2 and figures["deletion"]["images"] == 4
    assert scores["weights"]["policy.safetensors"]
    with np.load(tmp_path / "out/attributions.npz") as arrays:
        assert arrays["policy"].shape == (4, 128, 128)
        assert arrays["step"].tolist() == [0, 0, 3, 3] and arrays["episode"].tolist() == [0, 1] * 2
        assert np.array_equal(arrays["images"], result.frames.images.numpy())
    assert [p.name for p in (tmp_path / "out").glob("*.png")] == ["episode_00.png"]
    again = explain("ppo", run, SMALL, FakePhantom())
    assert torch.equal(again.maps["policy"], result.maps["policy"])
    assert again.scores["metrics"] == result.scores["metrics"]


def test_what_cannot_be_explained_is_refused(phantom, tmp_path):
    own_eyes = SimpleNamespace(name="it", observation="image", logits=None, encoder=object())
    with pytest.raises(RacinesError, match="no one image's pixels"):
        policy_logits(own_eyes)
    with pytest.raises(RacinesError, match="looks at no image"):
        explain("ppo", agent(tmp_path / "params", "params"), SMALL, phantom)
    with pytest.raises(RacinesError, match="looks at no image"):
        explain("planner", tmp_path, SMALL, phantom)
    with pytest.raises(RacinesError, match="trained for PL"):
        explain("ppo", agent(tmp_path / "pl", view="PL"), SMALL, phantom)
    config = replace(SMALL, view="A4C-beating")
    with pytest.raises(RacinesError, match="a task on patients"):
        explain("ppo", agent(tmp_path / "beating", view="A4C-beating"), config, phantom)
    with pytest.raises(RacinesError, match="explain.every is 0"):
        explain("ppo", tmp_path, ExplainConfig(every=0), phantom)

    class Blind:
        name, observation = "blind", "image"

    with pytest.raises(RacinesError, match="no logits"):
        policy_logits(Blind())


def test_true_regions_lie_where_the_image_shows_them(real_phantom):
    pose = real_phantom.target("SC")
    regions = true_regions(real_phantom, pose, "SC")
    sector = sector_of(real_phantom)
    image = real_phantom.render(pose, torch.zeros(1, dtype=torch.int64))[0].float()
    borders, organ = regions["borders"][0] & sector, regions["organ"][0] & sector
    assert float(image[borders].mean()) > 1.5 * float(image[sector & ~borders].mean())
    assert 0.2 < float(organ.sum() / sector.sum()) < 0.95
    assert 0.01 < float((regions["landmarks"][0] & sector).sum() / sector.sum()) < 0.6
    points = plane_points(real_phantom.config.probe, pose)
    apex = points[0, 0, 63:65].mean(0)
    assert float((apex - pose.position[0]).norm()) < 0.002
    shifted = Pose(pose.position + torch.tensor([0.02, 0.0, 0.0]), pose.rotation)
    assert not torch.equal(true_regions(real_phantom, shifted, "SC")["borders"], regions["borders"])
    assert true_regions(FakePhantom(), pose, "SC") == {}


@pytest.mark.slow
def test_the_command(tmp_path):
    run = agent(tmp_path / "envs/runs/ppo")
    words = [
        "--starts",
        "1",
        "--set",
        "frames=1",
        "--set",
        "steps=4",
        "--random-maps",
        "1",
        "--json",
    ]
    done = command(tmp_path, "racines", "explain", "ppo", "--view", "SC", *words)
    figures = json.loads(done.stdout)["metrics"]["policy"]
    assert 0 < figures["overlap_borders_by_chance"]["value"] < 1
    assert (tmp_path / "envs/runs/explain/ppo/episode_00.png").stat().st_size > 1000
    agent(run, "params")
    refused = command(tmp_path, "racines", "explain", "ppo", *words, code=1)
    assert "looks at no image" in refused.stderr
