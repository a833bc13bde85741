"""What can be had without looking: at most a fifth of the starts, in every view, still or beating.

The planner, who is told the truth, finds the view in nearly all of them (a short axis may slip from
a beating heart within the last steps), so the rest is there to be found.
"""

import pytest

from racines_data.views import VIEWS
from racines_envs.agents.blind import BlindConfig, BlindTourAgent, ConstantPoseAgent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients
from tests.conftest import ROOT

MOST, THERE = 0.2, 0.95
PATIENTS, STARTS = 40, 2


@pytest.fixture(scope="module")
def floors(tmp_path_factory):
    folder = tmp_path_factory.mktemp("floor")
    return ConstantPoseAgent.train(BlindConfig(), folder), BlindTourAgent.load(folder)


@pytest.mark.thorough
@pytest.mark.parametrize("tier", ["patients", "beating"])
@pytest.mark.parametrize("view", VIEWS)
def test_who_does_not_look_finds_few_views(floors, tmp_path, view: str, tier: str):
    config = PatientsConfig(view=f"{view}-{tier}", patients=PATIENTS, starts=STARTS)
    for agent in floors:
        scores = evaluate_patients("floor", tmp_path, config, agent=agent).scores["metrics"]
        assert scores["declared"]["value"] >= THERE
        assert scores["success_declared"]["value"] <= MOST, agent.name
    told = evaluate_patients("planner", tmp_path, config, agent=PlannerAgent()).scores["metrics"]
    assert told["success_declared"]["value"] >= THERE


@pytest.mark.thorough
@pytest.mark.parametrize("tier", ["patients", "beating"])
@pytest.mark.parametrize("view", VIEWS)
def test_who_learned_from_the_pose_finds_few_views(view: str, tier: str):
    """The published PPO, each of its trainings."""
    run = ROOT / "envs/weights" / tier / f"ppo-{view.lower()}"
    config = PatientsConfig(view=f"{view}-{tier}", patients=PATIENTS // 2, starts=STARTS)
    scores = evaluate_patients("ppo", run, config).scores
    assert scores["task"]["observation"] == "params" and len(scores["trainings"]) == 3
    assert scores["metrics"]["success_declared"]["value"] <= MOST
