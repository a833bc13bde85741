"""The loop that lets agents act: every episode at once, and none longer than it lasts."""

import numpy as np
import torch

from racines_envs.agents import load_agent
from racines_envs.agents.ppo import PPOAgent
from racines_envs.agents.rollout import rollout
from racines_envs.worlds.making import make_core
from tests.conftest import ROOT


def test_rows_that_have_ended_are_not_drawn_again_and_nothing_else_changes(phantom, tmp_path):
    """Episodes of a rollout are those of a core that looks at all rows at every step."""

    def core():
        return make_core("SC", 6, observation="multimodal", reward="oracle", phantom=phantom)

    agent, seeds = load_agent("planner", tmp_path), torch.arange(6) + 5
    rolled, plain = core(), core()
    phantom.rendered = 0
    final = rollout(rolled, agent, seeds).final
    assert final["steps"].min() < final["steps"].max()
    assert phantom.rendered == 6 + final["steps"].sum()
    agent.attach(plain)
    observation = plain.reset(seeds)
    for _ in range(int(final["steps"].max())):
        observation = plain.step(agent.act(observation, plain.decision_seeds())).observation
    for name, value in plain.info().items():
        np.testing.assert_array_equal(final[name], value.numpy(), err_msg=name)
    for name, value in rolled.observe().items():
        assert torch.equal(value, observation[name]), name


def test_a_policy_that_meets_its_environment_is_shown_all_rows():
    """A package's own policy may keep a memory of each row, which it begins in `attach`."""

    class Recurrent(PPOAgent):
        def attach(self, core):
            self.memory = torch.zeros(core.num_envs)

    class Plain(PPOAgent):
        pass

    assert Recurrent.remembers and not Plain.remembers and not PPOAgent.remembers


def test_who_keeps_no_memory_is_asked_of_live_rows_alone_and_acts_alike(monkeypatch):
    """A policy's episodes are the same whether or not it is shown what has ended."""
    agent = PPOAgent.load(ROOT / "envs/weights/phantom-default/ppo")
    seeds, asked = torch.arange(24) + 100, []
    act = PPOAgent.act

    def counted(self, observation, seeds):
        asked.append(len(seeds))
        return act(self, observation, seeds)

    monkeypatch.setattr(PPOAgent, "act", counted)

    def episodes(remembers: bool):
        asked.clear()
        monkeypatch.setattr(PPOAgent, "remembers", remembers)
        core = make_core("SC", 24, observation="params", reward="oracle")
        return rollout(core, agent, seeds), sum(asked)

    (every, many), (live, few) = episodes(True), episodes(False)
    assert many > few == live.final["steps"].sum()
    for name, value in every.final.items():
        np.testing.assert_array_equal(live.final[name], value, err_msg=name)
    np.testing.assert_array_equal(live.positions, every.positions)
    assert torch.equal(live.parameters, every.parameters)
