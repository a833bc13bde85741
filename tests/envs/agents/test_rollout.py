"""The loop that lets agents act: every episode at once, and none longer than it lasts."""

import numpy as np
import torch

from racines_envs.agents import load_agent
from racines_envs.agents.rollout import rollout
from racines_envs.worlds.making import make_core


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
