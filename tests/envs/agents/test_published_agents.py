"""The policies that come with the repository: they load, belong to this phantom, and arrive."""

import json
from pathlib import Path

import pytest
import torch

from racines_envs.agents import load_agent
from racines_envs.agents.rollout import rollout
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core, make_phantom, phantom_recipe

FOLDERS = sorted(path.parent for path in Path("envs/weights").glob("*/config.json"))
ELSEWHERE = "generator"
"""What was trained in a generator's images need not arrive on the phantom."""
STARTS = 5


def read(folder):
    return json.loads((folder / "config.json").read_text())


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_published_policy_loads_and_arrives(folder):
    told = read(folder)
    agent = load_agent(told["agent"], folder)
    phantom = make_phantom(None)
    made = json.loads((folder / "metrics.json").read_text()).get("phantom")
    assert made in (None, phantom_recipe(phantom)), "the phantom has changed: train them again"
    if told["config"].get("backend") == ELSEWHERE:
        return
    core = make_core(
        agent.view, STARTS, observation=agent.observation, reward="oracle", phantom=phantom
    )
    final = rollout(core, agent, evaluation_seeds(STARTS)).final
    assert int(final["success"].sum()) >= STARTS - 1


@pytest.mark.parametrize("path", sorted(Path("envs/weights").glob("*.onnx")), ids=lambda p: p.stem)
def test_its_onnx_file_acts_alike(path):
    folder = path.with_suffix("")
    agent, opened = load_agent(read(folder)["agent"], folder), load_agent(str(path), folder)
    core = make_core("SC", 3, observation=agent.observation, reward="oracle")
    seen = core.reset(seed=0)
    torch.testing.assert_close(opened.logits(seen), agent.logits(seen), atol=1e-3, rtol=1e-3)
