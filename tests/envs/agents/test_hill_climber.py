"""The hill-climber: it finds what its grader points at, and sees nothing but images."""

import json

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents import load_agent
from racines_envs.agents.hill_climber import HillClimberAgent, HillClimberConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.actions import IDLE
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_models.protocol import Judge
from tests.envs.fakes import FakePhantom


class GlowingPhantom(FakePhantom):
    """Images are the brighter the nearer to SC's nominal pose."""

    def render(self, pose, seeds):
        badness = (10.0 - self.judge(pose).view_grade[:, 1]) / 3.0
        target = self.target("SC")
        metres = (pose.position - target.position).norm(dim=-1)
        turn = (pose.rotation - target.rotation).square().sum((1, 2))
        level = 255.0 * torch.exp(-0.02 * badness - 15.0 * metres - 0.3 * turn)
        # Dithered, so that a mean over the pixels tells more than 256 levels.
        steps = torch.arange(128 * 128) / (128 * 128)
        return (level[:, None] + steps).clamp(0, 255).to(torch.uint8).view(-1, 128, 128)


class GlowGrader(Judge):
    """Likes bright images."""

    def probabilities_and_grade(self, images):
        level = images.float().mean((1, 2)) / 255.0
        p = torch.sigmoid((level - 0.75) * 30.0)
        return torch.stack([p] * 6, -1), 10.0 * level.clamp(0, 1)


class BlindGrader(Judge):
    """Says the same of every image."""

    def probabilities_and_grade(self, images):
        return torch.full((len(images), 6), 0.1), torch.zeros(len(images))


def climb(grader, count=50, **settings):
    core = make_core(
        "SC", count, observation="image", reward="oracle", phantom=GlowingPhantom(reach=2.0)
    )
    agent = HillClimberAgent(HillClimberConfig(**settings), grader)
    return core, agent


def test_it_climbs_to_the_view_where_the_grader_points_there():
    core, agent = climb(GlowGrader(), margin=0.02)
    seeds = evaluation_seeds(50)
    climbed = rollout(core, agent, seeds).final["success"].mean()
    chance = rollout(core, RandomAgent(), seeds).final["success"].mean()
    assert climbed > 0.9 and climbed > chance + 0.3


def test_it_repeats_and_a_row_ignores_its_batch():
    core, agent = climb(GlowGrader(), 6)
    seeds = evaluation_seeds(6)
    whole, again = rollout(core, agent, seeds), rollout(core, agent, seeds)
    assert (whole.positions == again.positions).all()
    one, agent = climb(GlowGrader(), 1)
    alone = rollout(one, agent, seeds[3:4])
    steps = len(alone.positions)
    assert abs(whole.positions[:steps, 3] - alone.positions[:, 0]).max() < 1e-6


class CountingGrader(GlowGrader):
    """Counts the images that it is asked about."""

    def __init__(self):
        self.asked = 0

    def probabilities_and_grade(self, images):
        self.asked += len(images)
        return super().probabilities_and_grade(images)


def test_what_has_ended_is_not_judged_and_nothing_else_changes(monkeypatch):
    seeds, graders = evaluation_seeds(20), [CountingGrader(), CountingGrader()]
    core, agent = climb(graders[0], 20, margin=0.02)
    first = rollout(core, agent, seeds)
    core, agent = climb(graders[1], 20, margin=0.02)
    judge = HillClimberAgent._judge
    with monkeypatch.context() as patch:
        patch.setattr(agent, "_judge", lambda seen, ended: judge(agent, seen, ended & False))
        second = rollout(core, agent, seeds)
    assert all((first.final[key] == second.final[key]).all() for key in first.final)
    assert (first.positions == second.positions).all()
    assert graders[0].asked == first.final["steps"].sum()
    assert graders[1].asked == 20 * first.final["steps"].max() > graders[0].asked


@pytest.mark.parametrize("reach", [1, 3])
def test_it_undoes_what_did_not_help_and_walks_off_where_nothing_does(reach):
    core, agent = climb(BlindGrader(), 4, reach=reach, patience=3, walk=5)
    core.reset(seed=0)
    agent.attach(core)
    seeds = evaluation_seeds(4)
    actions = [agent.act({"image": torch.zeros(4, 128, 128)}, seeds) for _ in range(8 * reach + 6)]
    row = torch.stack(actions)[:, 0].tolist()
    for start in range(0, 6 * reach, 2 * reach):  # three tries, each there and back
        assert row[start : start + 2 * reach] == [row[start]] * reach + [row[start] ^ 1] * reach
    walked = row[6 * reach : 6 * reach + 5]
    assert len(set(walked)) == 1 and IDLE not in row


def test_it_stays_where_the_grader_sees_a_hit():
    core, agent = climb(GlowGrader(), 2)
    core.reset(seed=0)
    agent.attach(core)
    bright = {"image": torch.full((2, 128, 128), 255, dtype=torch.uint8)}
    for _ in range(3):
        assert agent.act(bright, evaluation_seeds(2)).tolist() == [IDLE, IDLE]


def test_its_settings_are_kept_in_a_folder(tmp_path):
    HillClimberAgent.train(HillClimberConfig(walk=9, grader="somewhere"), tmp_path)
    loaded = load_agent("hill-climber", tmp_path)
    assert loaded.config == HillClimberConfig(walk=9, grader="somewhere")
    assert load_agent("hill-climber", tmp_path / "none").config == HillClimberConfig()
    (tmp_path / "config.json").write_text(json.dumps({"agent": "ppo", "config": {}}))
    with pytest.raises(RacinesError, match="ppo"):
        load_agent("hill-climber", tmp_path)


def test_without_task_or_grader_it_says_so(tmp_path):
    with pytest.raises(RacinesError, match="attach"):
        HillClimberAgent().act({"image": torch.zeros(1, 128, 128)}, evaluation_seeds(1))
    core, _ = climb(GlowGrader(), 1)
    with pytest.raises(RacinesError, match="racines train grader"):
        HillClimberAgent(HillClimberConfig(grader=str(tmp_path))).attach(core)
