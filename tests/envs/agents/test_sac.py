"""SAC: it learns to command twists, repeats, resumes, and refuses settings that cannot be."""

from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents import load_agent
from racines_envs.agents.contract import check_policy
from racines_envs.agents.onnx.policy import OnnxPolicyAgent, export_policy
from racines_envs.agents.protocol import acts
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.agents.sac import SACAgent, SACConfig
from racines_envs.evaluation.run import core_for
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_models.contract import ContractError
from tests.envs.fakes import FakePhantom

TINY = SACConfig(
    frames=1024, envs=16, update_every=128, updates=2, batch_size=32, buffer=2048, warmup=128,
    hidden=(32, 32), validate_every=256, validation_starts=4,
)  # fmt: skip


@pytest.mark.thorough
def test_it_learns_an_easy_view(tmp_path):
    """Some ten thousand steps are enough to beat chance where the view is wide."""
    phantom = FakePhantom(reach=2.0)
    config = replace(
        TINY, frames=10_240, envs=64, update_every=512, updates=24, batch_size=128, buffer=12_288,
        warmup=1024, learning_rate=2e-3, validate_every=10_240, validation_starts=25,
    )  # fmt: skip
    SACAgent.train(config, tmp_path, phantom=phantom, progress=False)
    agent, seeds = load_agent("sac", tmp_path), evaluation_seeds(100)
    core = core_for(agent, "SC", 100, reward="oracle", phantom=phantom)
    assert core.motion.name == "velocity"
    learned = rollout(core, agent, seeds).final["success"].mean()
    steps = make_core("SC", 100, observation="params", reward="oracle", phantom=phantom)
    chance = rollout(steps, RandomAgent(), seeds).final["success"].mean()
    assert learned > chance + 0.25


@pytest.mark.usefixtures("short_episodes")
def test_it_is_reproducible(phantom, tmp_path):
    folders = [tmp_path / str(i) for i in range(2)]
    first, second = (SACAgent.train(TINY, f, phantom=phantom, progress=False) for f in folders)
    pairs = zip(first.actor.state_dict().values(), second.actor.state_dict().values(), strict=True)
    assert all(torch.equal(ours, theirs) for ours, theirs in pairs)
    loaded = load_agent("sac", folders[0])
    seen = {"params": torch.rand(5, 9)}
    assert torch.equal(first.act(seen, torch.zeros(5)), loaded.act(seen, torch.zeros(5)))
    assert torch.equal(loaded.act(seen, torch.zeros(5))[:1],
                       loaded.act({"params": seen["params"][:1]}, torch.zeros(1)))  # fmt: skip


def test_it_does_not_learn_to_see_from_reward(tmp_path):
    with pytest.raises(RacinesError, match="name an encoder, e.g. `explored`"):
        SACAgent.train(replace(TINY, observation="image"), tmp_path)
    with pytest.raises(RacinesError, match="must not fall"):
        SACAgent.train(replace(TINY, warmup=8), tmp_path)


def test_a_file_of_it_commands_the_same_twists(tmp_path):
    pytest.importorskip("onnxruntime")
    config = replace(TINY, frames=256, warmup=64)
    agent = SACAgent.train(config, tmp_path, phantom=FakePhantom(), progress=False)
    export_policy(agent, tmp_path / "policy.onnx")
    opened = OnnxPolicyAgent(tmp_path / "policy.onnx")
    assert acts(opened) == "velocity" and opened.interface.output == "twist"
    chance = torch.Generator().manual_seed(0)
    seen, seeds = {"params": torch.rand(20, 9, generator=chance)}, torch.arange(20)
    assert torch.allclose(opened.act(seen, seeds), agent.act(seen, seeds), atol=1e-6)
    check_policy(opened.act, opened.logits, "params", seen, seeds, 0.0, twists=True)
    with pytest.raises(ContractError, match=r"give int64 \(0,\) of 0 to 12"):
        check_policy(opened.act, opened.logits, "params", seen, seeds, 0.0)
