"""How a policy reads the pose's rotation: continuously, or as the angles that jump."""

import math
from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import euler_to_matrix, rotation_6d
from racines_envs.agents import load_agent
from racines_envs.agents.networks import ROTATIONS, ObservationNetwork
from racines_envs.agents.onnx.policy import OnnxPolicyAgent, export_policy
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig

TINY = PPOConfig(frames=256, envs=8, update_every=128, validate_every=256, validation_starts=2)


def two_sides_of_the_jump():
    """Return (2, 9) parameters of two rotations 0.02 rad apart, whose first angle is ±π."""
    angles = torch.tensor([[math.pi - 0.01, 0.0, 0.0], [-math.pi + 0.01, 0.0, 0.0]])
    return torch.cat([torch.zeros(2, 3), rotation_6d(euler_to_matrix(angles))], -1)


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_angles_tear_neighbours_apart(rotation):
    torch.manual_seed(0)
    network = ObservationNetwork("params", 1, (32, 32), 1.0, rotation=rotation).eval()
    first, second = network(two_sides_of_the_jump())
    apart = float((first - second).detach().abs())
    assert apart > 0.05 if rotation == "euler" else apart < 0.02


def test_a_policy_of_angles_trains_loads_and_exports(phantom, tmp_path):
    config = replace(TINY, rotation="euler")
    agent = PPOAgent.train(config, tmp_path, phantom=phantom, progress=False)
    loaded = load_agent("ppo", tmp_path)
    seen = {"params": two_sides_of_the_jump()}
    assert torch.equal(loaded.logits(seen), agent.logits(seen))
    export_policy(agent, tmp_path / "policy.onnx")
    opened = OnnxPolicyAgent(tmp_path / "policy.onnx")
    torch.testing.assert_close(opened.logits(seen), agent.logits(seen), atol=1e-4, rtol=1e-4)


def test_another_rotation_is_refused():
    with pytest.raises(RacinesError, match="continuous or euler"):
        make_actor(PPOConfig(rotation="quaternion"))
