"""Agents: one contract for all, and what each is for."""

import json
import shutil
from dataclasses import asdict, replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents import agent_class, agent_names, load_agent, sees
from racines_envs.agents.behaviour_cloning import BehaviourCloningAgent, BehaviourCloningConfig
from racines_envs.agents.dqn import DQNAgent, DQNConfig
from racines_envs.agents.hill_climber import HillClimberAgent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.agent_specs import find_run
from racines_envs.task.actions import IDLE
from racines_envs.task.core import OBSERVATIONS
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from tests.envs.fakes import FakeGrader, FakePhantom

TINY = PPOConfig(
    frames=2048, envs=16, update_every=512, minibatch=256, epochs=2, hidden=(32, 32),
    validate_every=512, validation_starts=8,
)  # fmt: skip


def untrained(observation: str) -> PPOAgent:
    torch.manual_seed(0)
    config = replace(TINY, observation=observation)
    return PPOAgent(config, make_actor(config))


def near_uniform(config):
    torch.manual_seed(0)
    return config, make_actor(config)


AGENTS = {
    "random": RandomAgent,
    "planner": PlannerAgent,
    "hill-climber": lambda: HillClimberAgent(grader=FakeGrader()),
    "behaviour-cloning": lambda: BehaviourCloningAgent(*near_uniform(BehaviourCloningConfig())),
    "dqn": lambda: DQNAgent(*near_uniform(DQNConfig())),
    **{f"ppo {kind}": (lambda kind=kind: untrained(kind)) for kind in OBSERVATIONS},
}


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize("name", AGENTS)
class TestContract:
    """Holds for every agent; a new one joins by a line in AGENTS."""

    def make(self, name, phantom, count):
        agent = AGENTS[name]()
        core = make_core(
            "SC", count, observation=agent.observation, reward="oracle", phantom=phantom
        )
        return agent, core

    def test_actions_are_integers_0_to_12_a_row(self, name, phantom):
        agent, core = self.make(name, phantom, 7)
        seen = core.reset(seed=0)
        agent.attach(core)
        for _ in range(5):
            action = agent.act(seen, core.decision_seeds())
            assert action.shape == (7,) and action.dtype == torch.int64
            assert int(action.min()) >= 0 and int(action.max()) <= IDLE
            seen = core.step(action).observation

    def test_a_rows_action_ignores_its_batch_and_repeats(self, name, phantom):
        agent, core = self.make(name, phantom, 6)
        seeds = evaluation_seeds(6)
        whole = rollout(core, agent, seeds)
        again = rollout(core, agent, seeds)
        assert (whole.positions == again.positions).all()
        agent, one = self.make(name, phantom, 1)
        alone = rollout(one, agent, seeds[2:3])
        steps = len(alone.positions)
        assert abs(whole.positions[:steps, 2] - alone.positions[:, 0]).max() < 1e-6

    def test_it_names_itself_and_its_settings(self, name, phantom):
        agent = AGENTS[name]()
        assert agent.name in agent_names()
        assert agent_class(agent.name) is type(agent)
        assert asdict(type(agent).Config()) is not None
        assert agent.observation in OBSERVATIONS
        told = {"planner": "truth", "random": "nothing", "hill-climber": "grade"}
        assert sees(agent) == told.get(agent.name, agent.observation)


def test_unknown_agents_and_classes_that_are_none_are_refused(tmp_path):
    with pytest.raises(RacinesError, match="planner, ppo, ppo-belief, random"):
        agent_class("ddpg")
    with pytest.raises(RacinesError, match="lacks"):
        agent_class("pathlib:Path")
    with pytest.raises(RacinesError, match="cannot import nowhere.at.all"):
        agent_class("nowhere.at.all:Agent")
    with pytest.raises(RacinesError, match="racines train agent ppo"):
        load_agent("ppo", tmp_path)


def test_what_has_nothing_to_learn_leaves_its_settings(tmp_path):
    """So that each run has its folder, which other commands find it by."""
    RandomAgent.train(RandomAgent.Config(), tmp_path / "floor")
    assert find_run(str(tmp_path / "floor")).agent == "random"
    assert json.loads((tmp_path / "floor/metrics.json").read_text()) == {}


def test_the_random_agent_uses_all_actions_alike(phantom):
    drawn = RandomAgent().act({}, evaluation_seeds(13_000))
    counts = torch.bincount(drawn, minlength=13)
    assert counts.min() > 850 and counts.max() < 1150


def test_the_planner_arrives_idles_and_keeps_the_limits(phantom):
    core = make_core("PL", 200, observation="params", reward="oracle", phantom=phantom)
    final = rollout(core, PlannerAgent(), evaluation_seeds(200)).final
    assert final["success_graded"].mean() >= 0.95
    assert (final["workspace_hits"] + final["force_hits"]).sum() == 0
    assert final["peak_force"].max() <= core.task.force_limit
    core.reset(seed=0, pose=None)
    core.reset(seed=0)
    agent = PlannerAgent()
    agent.attach(core)
    for _ in range(60):
        action = agent.act({}, core.decision_seeds())
        core.step(action)
    assert bool((action[core.state.streak >= 1] == IDLE).all())
    with pytest.raises(RacinesError, match="attach"):
        PlannerAgent().act({}, evaluation_seeds(1))


# -- PPO -------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_ppo_trains_saves_and_loads(phantom, tmp_path, observation):
    config = replace(
        TINY, observation=observation, frames=256, update_every=128, validate_every=128
    )
    agent = PPOAgent.train(config, tmp_path, phantom=phantom, seed=1, progress=False)
    loaded = load_agent("ppo", tmp_path)
    for ours, theirs in zip(
        agent.actor.state_dict().values(), loaded.actor.state_dict().values(), strict=True
    ):
        assert torch.equal(ours, theirs)
    assert loaded.config == config and loaded.view == "SC"
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["frames"] == 256 and len(metrics["history"]) == 2
    curves = {p.stem for p in (tmp_path / "dvclive").rglob("*.tsv")}
    assert {"success", "loss_objective", "loss_critic", "frames_per_second"} <= curves
    assert not (tmp_path / "checkpoint").exists()


def test_ppo_trains_under_another_rule_of_the_end(phantom, tmp_path):
    config = replace(TINY, observation="params", frames=256, update_every=128, validate_every=256)
    PPOAgent.train(
        replace(config, termination="timeout"), tmp_path, phantom=phantom, progress=False
    )
    history = json.loads((tmp_path / "metrics.json").read_text())["history"]
    assert [row["validation/steps"] for row in history] == [200.0]
    with pytest.raises(RacinesError, match="termination"):
        PPOAgent.train(replace(config, termination="never"), tmp_path, phantom=phantom)


def test_ppo_is_reproducible_and_leaves_the_global_random_state_alone(phantom, tmp_path):
    torch.manual_seed(123)
    before = torch.get_rng_state()
    agents = [
        PPOAgent.train(
            replace(TINY, frames=1024), tmp_path / str(i), phantom=phantom, progress=False
        )
        for i in range(2)
    ]
    assert torch.equal(torch.get_rng_state(), before)
    a, b = (agent.actor.state_dict() for agent in agents)
    assert all(torch.equal(a[key], b[key]) for key in a)


def test_ppo_resumes_after_a_kill(phantom, tmp_path, monkeypatch):
    from racines_envs.agents import ppo

    real, calls = ppo.PPOTraining._validate, []

    def killed(self):
        calls.append(self.frames)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(self)

    monkeypatch.setattr(ppo.PPOTraining, "_validate", killed)
    with pytest.raises(KeyboardInterrupt):
        PPOAgent.train(TINY, tmp_path, phantom=phantom, progress=False)
    assert (tmp_path / "checkpoint").is_dir() and not (tmp_path / "policy.safetensors").exists()
    shutil.copytree(tmp_path, tmp_path / "copy")
    PPOAgent.train(TINY, tmp_path, phantom=phantom, progress=False, resume=True)
    assert calls == [512, 1024, 1536, 1536, 2048]
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert [row["frames"] for row in metrics["history"]] == [512, 1024, 1536, 2048]
    with pytest.raises(RacinesError, match="gamma"):
        PPOAgent.train(
            replace(TINY, gamma=0.5),
            tmp_path / "copy",
            phantom=phantom,
            progress=False,
            resume=True,
        )


def test_ppo_learns_an_easy_view(tmp_path):
    """Some ten thousand steps are enough to beat chance where the view is wide."""
    phantom = FakePhantom(reach=2.0)
    config = replace(
        TINY, frames=32_768, envs=64, update_every=2048, minibatch=512, epochs=5,
        validate_every=32_768, validation_starts=25,
    )  # fmt: skip
    PPOAgent.train(config, tmp_path, phantom=phantom, progress=False)
    core = make_core("SC", 100, observation="params", reward="oracle", phantom=phantom)
    seeds = evaluation_seeds(100)
    learned = rollout(core, load_agent("ppo", tmp_path), seeds).final["success"].mean()
    chance = rollout(core, RandomAgent(), seeds).final["success"].mean()
    assert learned > chance + 0.25


def test_ppo_refuses_settings_and_files_that_do_not_fit(phantom, tmp_path):
    with pytest.raises(RacinesError, match="multiple of envs"):
        PPOAgent.train(replace(TINY, update_every=500), tmp_path, phantom=phantom)
    untrained("params").save(tmp_path, {}, 0)
    described = tmp_path / "config.json"
    content = json.loads(described.read_text())
    described.write_text(json.dumps({**content, "agent": "dqn"}))
    with pytest.raises(RacinesError, match="dqn"):
        load_agent("ppo", tmp_path)
    content["config"]["hidden"] = [16, 16]
    described.write_text(json.dumps(content))
    with pytest.raises(RacinesError, match="does not fit"):
        load_agent("ppo", tmp_path)
    (tmp_path / "policy.safetensors").write_bytes(b"not safetensors")
    with pytest.raises(RacinesError, match="cannot be read.*racines train agent ppo"):
        load_agent("ppo", tmp_path)
