"""A training that was cut short: what it goes on with, and what it refuses to go on with."""

from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents.behaviour_cloning import (
    BehaviourCloningAgent,
    BehaviourCloningConfig,
    CloningLearner,
)
from racines_envs.agents.dqn import DQNAgent, DQNConfig
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.training import TrainingRun, environment_identity
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.networks.grading import GraderNetwork
from tests.envs.agents.test_behaviour_cloning import sweeps

pytestmark = pytest.mark.usefixtures("short_episodes")
PPO = PPOConfig(
    frames=512, envs=8, update_every=128, minibatch=64, epochs=1, hidden=(16, 16),
    validate_every=128, validation_starts=2,
)  # fmt: skip
DQN = DQNConfig(
    frames=512, envs=8, update_every=128, updates=1, batch_size=16, buffer=512, warmup=64,
    hidden=(16, 16), validate_every=128, validation_starts=2,
)  # fmt: skip
LEARNERS = {"ppo": (PPOAgent, PPO), "dqn": (DQNAgent, DQN)}


def save_encoder(folder, seed=0):
    torch.manual_seed(seed)
    PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125)).save(folder)
    return str(folder)


def save_grader(folder, seed=0):
    torch.manual_seed(seed)
    config = GraderConfig(input_size=32, width=0.125, bf16=False)
    Grader(GraderNetwork(32, 0.125), config).save(folder)
    return str(folder)


@pytest.fixture
def dies(monkeypatch):
    """Let each training die at its n-th validation, and count them all."""
    real, state = TrainingRun._validate, {"calls": 0, "at": 0}

    def validate(self):
        state["calls"] += 1
        if state["calls"] == state["at"]:
            raise KeyboardInterrupt
        return real(self)

    monkeypatch.setattr(TrainingRun, "_validate", validate)
    return state


def cut_short(dies, cls, config, folder, **where):
    dies |= {"calls": 0, "at": 3}
    with pytest.raises(KeyboardInterrupt):
        cls.train(config, folder, progress=False, **where)
    assert (folder / "checkpoint/last.pt").is_file()
    dies |= {"calls": 0, "at": 0}


@pytest.mark.parametrize("name", LEARNERS)
def test_moved_artefacts_go_on_and_changed_ones_are_refused(phantom, tmp_path, dies, name):
    cls, config = LEARNERS[name]
    config = replace(
        config,
        observation="image",
        reward="paper",
        encoder=save_encoder(tmp_path / "encoder"),
        grader=save_grader(tmp_path / "grader"),
    )
    run = tmp_path / "run"
    cut_short(dies, cls, config, run, phantom=phantom)

    def resume(**changes):
        return cls.train(
            replace(config, **changes), run, phantom=phantom, progress=False, resume=True
        )

    with pytest.raises(RacinesError, match=r"last\.pt: .* made with another encoder; use --fresh"):
        resume(encoder=save_encoder(tmp_path / "other", seed=1))
    with pytest.raises(RacinesError, match=r"last\.pt: .* made with another grader; use --fresh"):
        resume(grader=save_grader(tmp_path / "judge", seed=1))
    (tmp_path / "encoder").rename(tmp_path / "moved")
    (tmp_path / "grader").rename(tmp_path / "elsewhere")
    resume(encoder=str(tmp_path / "moved"), grader=str(tmp_path / "elsewhere"))
    assert dies["calls"] == 2, "the first half was not trained again"


def test_a_generator_counts_by_its_weights(phantom, tmp_path):
    def identity(folder):
        config = replace(PPO, backend="generator", generator=str(folder))
        return environment_identity(config, phantom)

    weights = tmp_path / "cgan/model.safetensors"
    weights.parent.mkdir()
    weights.write_bytes(b"weights")
    first = identity(tmp_path / "cgan")
    assert first["generator"] and first["grader"] is None
    weights.parent.rename(tmp_path / "moved")
    assert identity(tmp_path / "moved") == first
    (tmp_path / "moved/model.safetensors").write_bytes(b"others")
    assert identity(tmp_path / "moved") != first


def test_a_cloned_policy_goes_on_with_a_moved_encoder_only(phantom, tmp_path, monkeypatch):
    store, run = sweeps(phantom, 10), tmp_path / "run"
    config = BehaviourCloningConfig(
        encoder=save_encoder(tmp_path / "encoder"), epochs=3, batch_size=64, hidden=(16, 16)
    )
    real, epochs = CloningLearner.look, []

    def dying(self, *given):
        epochs.append(len(self.history))
        if len(epochs) == 2:
            raise KeyboardInterrupt
        return real(self, *given)

    def train(config, **where):
        return BehaviourCloningAgent.train(
            config, run, data=store, phantom=phantom, progress=False, **where
        )

    monkeypatch.setattr(CloningLearner, "look", dying)
    with pytest.raises(KeyboardInterrupt):
        train(config)
    other = replace(config, encoder=save_encoder(tmp_path / "other", seed=1))
    with pytest.raises(RacinesError, match="made with another encoder"):
        train(other, resume=True)
    (tmp_path / "encoder").rename(tmp_path / "moved")
    train(replace(config, encoder=str(tmp_path / "moved")), resume=True)
    assert epochs == [0, 1, 1, 2]


def test_a_killed_run_in_a_folder_that_stayed_goes_on(phantom, tmp_path, dies):
    """So it is under DVC, which leaves the folder of a persistent output as it is."""
    PPOAgent.train(replace(PPO, frames=256), tmp_path, phantom=phantom, progress=False)
    old = (tmp_path / "policy.safetensors").read_bytes()
    cut_short(dies, PPOAgent, PPO, tmp_path, phantom=phantom)
    assert (tmp_path / "policy.safetensors").read_bytes() == old
    PPOAgent.train(PPO, tmp_path, phantom=phantom, progress=False)
    assert dies["calls"] == 2
    assert (tmp_path / "policy.safetensors").read_bytes() != old


def test_a_finished_run_is_not_taken_for_a_killed_one(phantom, tmp_path, dies):
    for _ in range(2):
        dies["calls"] = 0
        PPOAgent.train(PPO, tmp_path, phantom=phantom, progress=False)
        assert dies["calls"] == 4, "all of it is trained"
        (curve,) = tmp_path.rglob("validation/success.tsv")
        assert len(curve.read_text().splitlines()) == 5, "with curves of its own"
    with pytest.raises(RacinesError, match="cannot resume: there is none; use --fresh"):
        PPOAgent.train(PPO, tmp_path, phantom=phantom, progress=False, resume=True)


def test_changed_settings_start_anew_and_say_so(phantom, tmp_path, dies, capsys):
    cut_short(dies, PPOAgent, PPO, tmp_path, phantom=phantom)
    PPOAgent.train(replace(PPO, gamma=0.9), tmp_path, phantom=phantom, progress=False)
    assert dies["calls"] == 4
    said = capsys.readouterr().err
    assert "last.pt: it was made with another gamma: training starts anew" in said
