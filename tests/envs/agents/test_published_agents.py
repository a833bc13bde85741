"""The policies that come with the repository: they load, belong to this phantom, and arrive."""

import json
from pathlib import Path

import pytest
import torch

from racines_envs.agents import load_agent
from racines_envs.agents.onnx.policy import export_run
from racines_envs.agents.rollout import rollout
from racines_envs.task.motion import DISCRETE
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core, make_phantom, phantom_recipe
from racines_envs.worlds.ward import make_ward
from tests.variants import first_of

WEIGHTS = Path("envs/weights")
FOLDERS = sorted(path.parent for path in WEIGHTS.glob("*/config.json"))
ON_PATIENTS = {"servo", "servo-memory", "ppo-belief"}
"""Agents that know patients, and not the one heart."""
FLOORS = {"constant-pose", "blind-tour"}
"""Agents that know patients and never look: what they find is little."""
ELSEWHERE = "generator"
"""What was trained in a generator's images need not arrive on the phantom."""
STARTS = 5


def read(folder):
    return json.loads((folder / "config.json").read_text())


def runs(patients: bool):
    """Return the folders of who knows patients, or the one heart."""
    known = [each for each in FOLDERS if read(each)["agent"] not in FLOORS]
    return [each for each in known if (read(each)["agent"] in ON_PATIENTS) == patients]


@pytest.mark.parametrize("name", sorted(FLOORS))
def test_a_published_floor_goes_to_its_poses_and_declares(name):
    agent = load_agent(name, WEIGHTS / name)
    ward = make_ward("patients", "train", 2)
    core = make_core("AnyView-patients", 10, observation="params", reward="oracle", phantom=ward)
    final = rollout(core, agent, evaluation_seeds(10)).final
    assert final["declared"].all() and final["success"].mean() <= 0.5
    told = json.loads((WEIGHTS / name / "metrics.json").read_text())
    assert told["train_patients"] == 120, "by the profile reference"


@pytest.mark.parametrize(
    "folder",
    # First the one with a memory, through the other's eyes.
    first_of(sorted(runs(patients=True), key=lambda folder: folder.name != "servo-memory")),
    ids=lambda folder: folder.name,
)
@pytest.mark.parametrize(
    "seed", ["", *(pytest.param(f"seed-{n}", marks=pytest.mark.thorough) for n in (1, 2))]
)
def test_a_published_policy_finds_most_train_patients_views(folder, seed):
    agent = load_agent(read(folder)["agent"], folder / seed)
    store = read(folder / seed)["config"].get("store", "")
    assert "/" not in store.removeprefix("envs/runs/")
    ward = make_ward("patients", "train", 2)
    core = make_core(
        "AnyView-patients", 10, observation=agent.observation, reward="oracle", phantom=ward
    )
    final = rollout(core, agent, evaluation_seeds(10)).final
    # A servo declares nearly always, ppo-belief in 78 to 95 % of the episodes of its rows.
    assert final["declared"].mean() >= 0.8 and final["success"].mean() >= 0.4


@pytest.mark.parametrize("folder", runs(patients=False), ids=lambda folder: folder.name)
def test_a_published_policy_loads_and_arrives(folder):
    told = read(folder)
    agent = load_agent(told["agent"], folder)
    phantom = make_phantom(None)
    made = json.loads((folder / "metrics.json").read_text()).get("phantom")
    assert made in (None, phantom_recipe(phantom)), "the phantom has changed: train them again"
    if told["config"].get("backend") == ELSEWHERE:
        return
    action = getattr(agent, "action", DISCRETE)
    core = make_core(
        agent.view, STARTS, observation=agent.observation, action=action, reward="oracle",
        phantom=phantom,
    )  # fmt: skip
    final = rollout(core, agent, evaluation_seeds(STARTS)).final
    assert int(final["success"].sum()) >= STARTS - 1


@pytest.mark.parametrize("name", ["behaviour-cloning", "dqn", "ppo", "ppo-image"])
def test_its_onnx_file_acts_alike(name, tmp_path):
    folder, path = WEIGHTS / name, WEIGHTS / f"{name}.onnx"
    if not path.is_file():  # one is published as such; others are exported when they are wanted
        path = tmp_path / path.name
        export_run(folder, path)
    agent, opened = load_agent(read(folder)["agent"], folder), load_agent(str(path), folder)
    core = make_core("SC", 3, observation=agent.observation, reward="oracle")
    seen = core.reset(seed=0)
    torch.testing.assert_close(opened.logits(seen), agent.logits(seen), atol=1e-3, rtol=1e-3)
