"""Watching: the episode is the evaluation's, and attributions are those of `racines explain`."""

import json

import numpy as np
import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.rollout import rollout
from racines_envs.explain.maps import integrated_gradients, policy_logits
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_leaderboard.studio import watching, worlds
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.watching import overlay
from tests.envs.fakes import FakeGrader, FakePhantom


def policy(folder, observation="image", view="SC", bias=0):
    """An untrained policy that mostly goes one way."""
    torch.manual_seed(0)
    config = PPOConfig(view=view, observation=observation, hidden=(16, 16))
    actor = make_actor(config)
    nn.init.normal_(actor.head.weight)
    PPOAgent(config, actor.eval()).save(folder, {}, bias)


@pytest.fixture
def place(tmp_path, monkeypatch):
    phantom = FakePhantom()
    monkeypatch.setattr(worlds, "load_phantom", lambda place, anatomy: phantom)
    monkeypatch.setattr(worlds, "load_grader", lambda place, labels, tier: FakeGrader())
    monkeypatch.setattr(watching, "_episodes", type(watching._episodes)(8))
    monkeypatch.setattr(watching, "_maps", type(watching._maps)(8))
    policy(tmp_path / "runs" / "seeing")
    policy(tmp_path / "runs" / "blind", "params", "PL")
    policy(tmp_path / "weights" / "seeing")
    return Place(data=None, agents=tmp_path / "runs", policies=tmp_path / "weights")


def test_what_can_be_watched(place, tmp_path):
    outside = tmp_path / "runs" / "outside"
    outside.mkdir()
    (outside / "policy.safetensors").write_bytes(b"")
    (outside / "config.json").write_text(json.dumps({"agent": "os:system", "config": {}}))
    (tmp_path / "runs" / "damaged").mkdir()
    (tmp_path / "runs" / "damaged" / "config.json").write_text("{")
    labels = list(watching.agents(place))
    ours = ["planner", "random", "hill-climber"]
    assert labels == [*ours, "seeing (published)", "blind", "seeing"]
    assert watching.tasks_of(place, "blind") == ["PL"]
    assert "SC" in watching.tasks_of(place, "planner") and "PL" in watching.tasks_of(
        place, "planner"
    )


def test_it_is_the_evaluations_episode(place):
    episode = watching.watch(place, "planner", "SC", 2)
    core = make_core("SC", phantom=FakePhantom(), observation="params", reward="oracle")
    known = rollout(core, PlannerAgent(), evaluation_seeds(3)[-1:])
    assert episode.steps == int(known.final["steps"][0])
    np.testing.assert_allclose(np.array(episode.history.positions), known.positions[:, 0])
    last = watching.moment(episode, episode.steps)
    assert last.success and last.ended and last.step == episode.steps
    first = watching.moment(episode, 0)
    assert not first.ended and first.action == "start" and (first.image != last.image).any()
    assert len(first.curves) == 2 and len(first.curves[0].grades) == episode.steps + 1


def test_the_hill_climber_goes_by_the_pages_grader(place, monkeypatch):
    episode = watching.watch(place, "hill-climber", "SC", 0)
    assert isinstance(episode.agent.guide, FakeGrader) and episode.steps > 0
    monkeypatch.setattr(worlds, "load_grader", lambda place, labels, tier: None)
    with pytest.raises(RacinesError, match="goes by a grader"):
        watching.watch(place, "hill-climber", "SC", 1)


def test_all_who_ask_for_an_episode_share_it(place):
    once, again = (watching.watch(place, "random", "SC", 0) for _ in range(2))
    assert once is again
    assert watching.watch(place, "random", "SC", 1) is not once
    assert watching.moment(once, 5).step == 5 and watching.moment(once, 0).step == 0


def test_a_policy_without_images_moves_as_it_was_trained(place):
    episode = watching.watch(place, "blind", "PL", 0)
    agent = PPOAgent.load(place.agents / "blind")
    core = make_core("PL", phantom=FakePhantom(), observation="params", reward="oracle")
    known = rollout(core, agent, evaluation_seeds(1))
    np.testing.assert_allclose(np.array(episode.history.positions), known.positions[:, 0])
    assert episode.explainable == (watching.OFF,)
    with pytest.raises(RacinesError, match="not offered"):
        watching.explain(episode, 0, watching.ACTION)


def test_attributions_are_integrated_gradients_of_the_action(place):
    episode = watching.watch(place, "seeing", "SC", 0)
    assert episode.explainable == (watching.OFF, watching.ACTION)
    drawn, p = watching.explain(episode, 1, watching.ACTION)
    agent = PPOAgent.load(place.agents / "seeing")
    image, params = episode.moments[1].image, episode.params[1:2]
    action = torch.tensor([episode.history.actions[2]])
    maps, _ = integrated_gradients(policy_logits(agent), image, params, action, watching.POINTS)
    np.testing.assert_allclose(drawn, maps[0].numpy(), rtol=1e-4, atol=1e-6)
    assert np.abs(drawn).max() > 0
    with torch.no_grad():
        logits = agent.logits({"image": image})
    assert p == pytest.approx(float(logits.softmax(-1)[0, action]), abs=1e-5)
    with pytest.raises(RacinesError, match="no action"):
        watching.explain(episode, episode.steps, watching.ACTION)


@pytest.mark.parametrize(
    ("agent", "task", "number"),
    [
        ("nobody", "SC", 0),
        ("blind", "SC", 0),
        ("planner", "../SC", 0),
        ("planner", "SC", 100),
        ("planner", "SC", float("nan")),
        (None, "SC", 0),
    ],
)
def test_what_was_not_offered_is_refused(place, agent, task, number):
    with pytest.raises(RacinesError):
        watching.watch(place, agent, task, number)


@pytest.mark.parametrize("step", [-1, 999, 0.5, float("nan"), "0"])
def test_a_step_that_is_none_is_refused(place, step):
    with pytest.raises(RacinesError):
        watching.moment(watching.watch(place, "random", "SC", 0), step)


def test_attributions_are_drawn_where_they_are():
    image = np.full((128, 128), 100, np.uint8)
    attributions = np.zeros((128, 128), np.float32)
    attributions[20:40, 20:40], attributions[80:100, 80:100] = 1.0, -1.0
    drawn = overlay(image, attributions).astype(int)
    assert drawn.shape == (384, 384, 3)
    red, blue = drawn[90, 90], drawn[270, 270]
    assert red[0] > red[2] + 100 and blue[2] > blue[0] + 100
    np.testing.assert_array_equal(drawn[180, 180], [80, 80, 80])
