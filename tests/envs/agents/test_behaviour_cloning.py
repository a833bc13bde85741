"""Behaviour cloning: labels by hindsight, what is learned from them, and the files of a run."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.views import LABELS
from racines_envs.agents import load_agent
from racines_envs.agents.behaviour_cloning import BehaviourCloningAgent, BehaviourCloningConfig
from racines_envs.agents.demonstrations import demonstrations, encode_params
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.policy import choose
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import OBSERVATIONS
from racines_envs.task.starts import evaluation_seeds, validation_seeds
from racines_envs.task.tasks import Task
from racines_envs.worlds.making import make_core
from tests.envs.fakes import FakePhantom

TINY = BehaviourCloningConfig(observation="params", epochs=3, batch_size=64, hidden=(32, 32))


class FakeStore:
    """Frames of a few sweeps in memory, with what is used of a `FrameStore`."""

    root, digest, manifest, labels = Path("data/racines"), "0" * 8, {}, LABELS
    phased, patients, config = False, None, "frames"

    def __init__(self, phantom, pose, trajectory, splits):
        truth = phantom.judge(pose)
        self.views, self.grades = truth.view, truth.grade
        self.parameters = pose_to_parameters(pose)
        self._phantom, self._pose = phantom, pose
        self.trajectory_index, self._splits = trajectory, splits

    def bounds(self, split):
        return self._splits[split]

    def take(self, index):
        pose = Pose(self._pose.position[index], self._pose.rotation[index])
        return SimpleNamespace(images=self._phantom.render(pose, index))


def sweeps(phantom, count=40, steps=25):
    """Return a store of the planner's ways from many starts; the last fifth is held out."""
    core = make_core("SC", count, observation="params", reward="oracle", phantom=phantom)
    seen, agent = core.reset(validation_seeds(count)), PlannerAgent()
    agent.attach(core)
    poses = []
    for _ in range(steps):
        poses.append(core.state.pose)
        seen = core.step(agent.act(seen, core.decision_seeds())).observation
    position = torch.stack([pose.position for pose in poses], 1).flatten(0, 1)
    rotation = torch.stack([pose.rotation for pose in poses], 1).flatten(0, 1)
    trajectory = torch.arange(count).repeat_interleave(steps)
    held = count // 5 * steps
    total = count * steps
    splits = {"train": (0, total - held), "validation": (total - held, total)}
    return FakeStore(phantom, Pose(position, rotation), trajectory, splits)


def line(phantom, shifts, trajectory):
    """Return a store of frames beside the target of SC, shifted along the probe's x by metres."""
    target = phantom.target("SC")
    along = target.rotation[0, :, 0] * torch.tensor(shifts).unsqueeze(1)
    pose = Pose(target.position + along, target.rotation.expand(len(shifts), 3, 3))
    splits = {"train": (0, len(shifts))}
    return FakeStore(phantom, pose, torch.tensor(trajectory), splits)


def test_a_frame_is_labelled_with_the_step_towards_what_its_sweep_came_to(phantom):
    shifts = [-0.04, -0.03, -0.02, 0.0, 0.02, -0.03, -0.02]
    store = line(phantom, shifts, [0, 0, 0, 0, 0, 1, 1])
    task = Task("SC")
    shown = demonstrations(store, "train", task)
    assert shown.rows.tolist() == [0, 1, 2, 3, 4]  # the second sweep never shows the view
    names = [ACTIONS[action] for action in shown.action.tolist()]
    assert names == ["+x", "+x", "+x", "idle", "-x"]
    assert shown.cost[0, IDLE] == pytest.approx((0.04 / task.step_translation) ** 2, rel=1e-3)
    assert shown.trajectories == 1
    forward = demonstrations(store, "train", task, both_ways=False)
    assert forward.rows.tolist() == [0, 1, 2, 3]
    assert demonstrations(store, "train", task, horizon=1).rows.tolist() == [2, 3, 4]


def test_a_goal_may_lie_on_any_sweep_of_the_same_heart(phantom):
    store = line(phantom, [-0.04, -0.03, 0.0, -0.03, -0.02, 0.03], [0, 0, 1, 2, 2, 3])
    assert demonstrations(store, "train", Task("SC")).rows.tolist() == [2]
    assert demonstrations(store, "train", Task("SC"), horizon=0).rows.tolist() == list(range(6))
    store.patients = [7, 7, 9, 7]  # no sweep of patient 9 came to the view
    shown = demonstrations(store, "train", Task("SC"), horizon=0)
    assert shown.rows.tolist() == [0, 1, 2, 5] and shown.trajectories == 3
    assert [ACTIONS[action] for action in shown.action.tolist()] == ["+x", "+x", "idle", "-x"]


def test_of_patients_it_imitates_the_config_of_their_tier(phantom, tmp_path, monkeypatch):
    from racines_envs.agents import behaviour_cloning

    store, opened = sweeps(phantom, 10), []
    monkeypatch.setattr(
        behaviour_cloning, "open_store", lambda *named: opened.append(named) or store
    )
    store.patients, store.config = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4], "patients"
    config = replace(TINY, view="SC-patients", horizon=0, epochs=1)
    for each in (config, replace(config, recordings="beating")):
        BehaviourCloningAgent.train(each, tmp_path, data="frames", resume=False, progress=False)
    assert [name for _, name in opened] == ["patients", "beating"]
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    accuracy = metrics["held_out_action_accuracy"]
    assert accuracy["unit"] == "mean over patients" and accuracy["n"] == 1
    with pytest.raises(RacinesError, match="SC-v0 cannot imitate config patients.*scans patients"):
        BehaviourCloningAgent.train(replace(TINY, epochs=1), tmp_path, data=store, resume=False)
    store.patients = None
    with pytest.raises(RacinesError, match="SC-patients-v0 cannot imitate .*scans one heart"):
        BehaviourCloningAgent.train(config, tmp_path, data=store, resume=False)


def test_recorded_poses_are_encoded_as_the_environment_encodes_them(phantom):
    core = make_core("SC", 5, observation="params", reward="oracle", phantom=phantom)
    seen = core.reset(seed=0)["params"]
    encoded = encode_params(pose_to_parameters(core.state.pose), phantom.workspace)
    torch.testing.assert_close(encoded, seen, atol=1e-5, rtol=0)


def test_it_learns_the_way_from_the_sweeps(tmp_path):
    phantom = FakePhantom(reach=2.0)
    config = replace(TINY, epochs=25, batch_size=128, learning_rate=3e-3)
    store = sweeps(phantom, 150)
    BehaviourCloningAgent.train(config, tmp_path, data=store, phantom=phantom, progress=False)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    accuracy = metrics["held_out_action_accuracy"]
    assert accuracy["value"] > 0.5 and 20 < accuracy["n"] <= 30
    assert metrics["held_out_helps"]["value"] >= accuracy["value"]
    core = make_core("SC", 100, observation="params", reward="oracle", phantom=phantom)
    seeds = evaluation_seeds(100)
    learned = rollout(core, load_agent("behaviour-cloning", tmp_path), seeds).final["success"]
    chance = rollout(core, RandomAgent(), seeds).final["success"]
    assert learned.mean() > chance.mean() + 0.3


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_it_trains_saves_and_loads(phantom, tmp_path, observation):
    config = replace(TINY, observation=observation, epochs=1)
    store = sweeps(phantom, 10)
    agent = BehaviourCloningAgent.train(
        config, tmp_path, data=store, phantom=phantom, progress=False
    )
    loaded = load_agent("behaviour-cloning", tmp_path)
    for ours, theirs in zip(
        agent.actor.state_dict().values(), loaded.actor.state_dict().values(), strict=True
    ):
        assert torch.equal(ours, theirs)
    assert loaded.config == config and loaded.observation == observation
    curves = {p.stem for p in (tmp_path / "dvclive").rglob("*.tsv")}
    assert {"loss", "action_accuracy", "helps"} <= curves
    assert not (tmp_path / "checkpoint").exists()


def test_an_encoder_looks_once_at_each_frame(phantom, tmp_path, monkeypatch):
    from racines_envs.agents import behaviour_cloning, policy

    class Encoder(torch.nn.Module):
        size, sha256, seen = 2, "e", 0

        def __init__(self):
            super().__init__()
            self.scale = torch.nn.Parameter(torch.ones(1))

        def forward(self, images):
            Encoder.seen += len(images)
            return torch.stack([images.float().mean((1, 2)), images.float().std((1, 2))], 1)

    for module in (behaviour_cloning, policy):
        monkeypatch.setattr(module, "open_encoder", lambda *spec: Encoder())
    store = sweeps(phantom, 10)
    config = replace(TINY, observation="image", encoder="pose")
    agent = BehaviourCloningAgent.train(
        config, tmp_path, data=store, phantom=phantom, progress=False
    )
    assert Encoder.seen <= 250 and agent.actor.keys == ["features"]
    core = make_core("SC", 3, observation="image", reward="oracle", phantom=phantom)
    assert load_agent("behaviour-cloning", tmp_path).act(
        core.reset(seed=0), core.decision_seeds()
    ).shape == (3,)


def test_what_cannot_be_imitated_is_refused(phantom, tmp_path):
    store = line(phantom, [-0.04, -0.03], [0, 0])
    with pytest.raises(RacinesError, match="nothing to imitate"):
        BehaviourCloningAgent.train(TINY, tmp_path, data=store, phantom=phantom)
    store.labels = ("KLX", "Random")
    with pytest.raises(RacinesError, match="no view SC"):
        BehaviourCloningAgent.train(TINY, tmp_path, data=store, phantom=phantom)
    with pytest.raises(RacinesError, match="epochs"):
        BehaviourCloningAgent.train(replace(TINY, epochs=0), tmp_path, data=store)


def test_actions_are_drawn_from_seeds_at_a_temperature():
    logits = torch.zeros(20_000, len(ACTIONS))
    logits[:, 3] = 2.0
    seeds = evaluation_seeds(20_000)
    drawn = choose(logits, seeds, 2.0)
    assert torch.equal(drawn[50:60], choose(logits[50:60], seeds[50:60], 2.0))
    share = float((drawn == 3).float().mean())
    assert share == pytest.approx(torch.e / (torch.e + 12), abs=0.01)
    assert bool((choose(logits, seeds, 0.0) == 3).all())


def test_the_command_learns_from_the_folder_it_is_given(phantom, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from racines_envs.agents import behaviour_cloning
    from racines_leaderboard.cli.command import app

    opened = []
    monkeypatch.setattr(
        behaviour_cloning, "open_store", lambda *named: opened.append(named) or store
    )
    monkeypatch.chdir(tmp_path)
    store = sweeps(phantom, 10)
    (tmp_path / "params.yaml").write_text("agents:\n  behaviour-cloning: {epochs: 1}\n")
    words = ["train", "agent", "behaviour-cloning", "--view", "SC", "--data", "frames", "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0 and opened == [(Path("frames"), "frames")]
    metrics = json.loads(done.stdout)
    assert metrics["epochs"] == 1 and metrics["demonstrations"]["train"]["trajectories"] in (7, 8)
    assert (tmp_path / "envs/runs/behaviour-cloning/policy.safetensors").is_file()
