"""DQN: it learns, repeats, resumes, and refuses settings that cannot be."""

import json
from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents import load_agent
from racines_envs.agents.dqn import DQNAgent, DQNConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.core import OBSERVATIONS
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from tests.envs.fakes import FakePhantom

TINY = DQNConfig(
    frames=1024, envs=16, update_every=128, updates=2, batch_size=32, buffer=2048, warmup=128,
    hidden=(32, 32), validate_every=256, validation_starts=4,
)  # fmt: skip


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_it_trains_saves_and_loads(phantom, tmp_path, observation):
    config = replace(TINY, observation=observation, frames=256)
    agent = DQNAgent.train(config, tmp_path, phantom=phantom, seed=1, progress=False)
    loaded = load_agent("dqn", tmp_path)
    for ours, theirs in zip(
        agent.actor.state_dict().values(), loaded.actor.state_dict().values(), strict=True
    ):
        assert torch.equal(ours, theirs)
    assert loaded.config == config and loaded.view == "SC"
    assert json.loads((tmp_path / "metrics.json").read_text())["frames"] == 256
    curves = {p.stem for p in (tmp_path / "dvclive").rglob("*.tsv")}
    assert {"success", "loss", "exploration", "frames_per_second"} <= curves
    assert not (tmp_path / "checkpoint").exists()


@pytest.mark.thorough
def test_it_learns_an_easy_view(tmp_path):
    """Some ten thousand steps are enough to beat chance where the view is wide."""
    phantom = FakePhantom(reach=2.0)
    config = replace(
        TINY, frames=12_288, envs=64, update_every=512, updates=24, batch_size=128, buffer=12_288,
        warmup=2048, learning_rate=1e-3, validate_every=12_288, validation_starts=25,
    )  # fmt: skip
    DQNAgent.train(config, tmp_path, phantom=phantom, progress=False)
    core = make_core("SC", 100, observation="params", reward="oracle", phantom=phantom)
    seeds = evaluation_seeds(100)
    learned = rollout(core, load_agent("dqn", tmp_path), seeds).final["success"].mean()
    chance = rollout(core, RandomAgent(), seeds).final["success"].mean()
    assert learned > chance + 0.25


@pytest.mark.usefixtures("short_episodes")
def test_it_is_reproducible_and_explores_less_and_less(phantom, tmp_path):
    folders = [tmp_path / str(i) for i in range(2)]
    agents = [DQNAgent.train(TINY, f, phantom=phantom, progress=False) for f in folders]
    a, b = (agent.actor.state_dict() for agent in agents)
    assert all(torch.equal(a[key], b[key]) for key in a)
    (curve,) = folders[0].rglob("exploration.tsv")
    shares = [float(line.split("\t")[-1]) for line in curve.read_text().splitlines()[1:]]
    assert shares[0] == 1.0 and shares[-1] == pytest.approx(0.05)
    assert shares == sorted(shares, reverse=True)


@pytest.mark.usefixtures("short_episodes")
def test_it_resumes_after_a_kill_with_its_target_network(phantom, tmp_path, monkeypatch):
    from racines_envs.agents import dqn

    real, calls, seen = dqn._Training._validate, [], {}

    def killed(self):
        calls.append(self.frames)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(self)

    def restored(self, state):
        restore(self, state)
        now = self._target()
        seen["same"] = all(torch.equal(now[name], state["target"][name]) for name in now)
        # The target follows behind: were it not restored, it would be the network itself.
        behind = self.loss.value_network_params.flatten_keys()["module.0.module.head.weight"]
        name = next(key for key in now if key.endswith("head.weight"))
        seen["behind"] = not torch.equal(now[name], behind)

    restore = dqn._Training._restore
    monkeypatch.setattr(dqn._Training, "_validate", killed)
    monkeypatch.setattr(dqn._Training, "_restore", restored)
    with pytest.raises(KeyboardInterrupt):
        DQNAgent.train(TINY, tmp_path, phantom=phantom, progress=False)
    assert not (tmp_path / "policy.safetensors").exists()
    DQNAgent.train(TINY, tmp_path, phantom=phantom, progress=False, resume=True)
    assert calls == [256, 512, 768, 768, 1024]
    assert seen == {"same": True, "behind": True}
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert [row["frames"] for row in metrics["history"]] == [256, 512, 768, 1024]


def test_settings_that_cannot_be_are_refused(phantom, tmp_path):
    with pytest.raises(RacinesError, match="multiple of envs"):
        DQNAgent.train(replace(TINY, update_every=100), tmp_path, phantom=phantom)
    with pytest.raises(RacinesError, match="must not fall"):
        DQNAgent.train(replace(TINY, warmup=9999), tmp_path, phantom=phantom)


def test_recordings_are_replayed_from_the_folder_it_is_given(phantom, tmp_path):
    config = replace(TINY, backend="replay")
    with pytest.raises(RacinesError, match="nowhere"):
        DQNAgent.train(config, tmp_path, phantom=phantom, data=tmp_path / "nowhere")
