"""Tasks of another organ than the heart."""

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

import racines_envs
from racines_data.errors import RacinesError
from racines_data.phantom import PhantomConfig, shared_phantom
from racines_data.phantom.config import BlockConfig
from racines_data.views import LABELS
from racines_envs import ScanEnv
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.run import EvaluationConfig, evaluate
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import Task, get_task
from racines_envs.worlds.making import make_core
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from tests.plugins.packages import install
from tests.variants import first_of

SETTINGS = {"observation": "params", "reward": "oracle"}
ABDOMEN = PhantomConfig(anatomy="abdomen")


@pytest.fixture(scope="module")
def abdomen():
    return shared_phantom(ABDOMEN)


@pytest.mark.parametrize("view", first_of(["GB", "KLX", "KSX"]))
def test_every_view_can_be_reached_and_is_not_reached_by_chance(abdomen, view):
    core = make_core(view, 100, phantom=abdomen, **SETTINGS)
    seeds = evaluation_seeds(100)
    core.reset(seeds)
    assert not bool(core.info()["success"].any())
    final = rollout(core, PlannerAgent(), seeds).final
    assert final["success"].mean() >= 0.9
    assert rollout(core, RandomAgent(), seeds).final["success"].mean() < 0.1


def test_its_tasks_are_made_by_their_ids_and_names(abdomen):
    env = gymnasium.make("racines_envs:racines/abdomen-GB-v0", phantom=abdomen, **SETTINGS)
    check_env(env.unwrapped, skip_render_check=True)
    task = env.unwrapped.core.task
    assert (task.view, task.anatomy, task.target) == ("GB", "abdomen", 2)
    envs = gymnasium.make_vec("racines_envs:racines/abdomen-KSX-v0", num_envs=2, **SETTINGS)
    assert envs.core.phantom is abdomen  # made from the task's anatomy, and shared
    assert ScanEnv("abdomen-KLX", 2, **SETTINGS).core.task == get_task("KLX", "abdomen")
    assert ScanEnv("KLX", 2, phantom=ABDOMEN, **SETTINGS).core.task.anatomy == "abdomen"


def test_organs_are_not_mixed_up(abdomen):
    with pytest.raises(RacinesError, match=r"unknown view 'SC': choose one of KLX, KSX, GB"):
        make_core("SC", phantom=abdomen, **SETTINGS)
    with pytest.raises(RacinesError, match="unknown view 'KLX': choose one of A4C"):
        make_core("KLX", **SETTINGS)
    with pytest.raises(RacinesError, match=r"PhantomConfig\(anatomy='abdomen'\)"):
        make_core("abdomen-KLX", phantom=PhantomConfig(), **SETTINGS)
    heart = Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125))
    assert heart.labels == LABELS
    with pytest.raises(RacinesError, match=r"the grader knows A4C.*the abdomen has KLX"):
        make_core("KLX", phantom=abdomen, observation="params", reward="paper", grader=heart)
    with pytest.raises(RacinesError, match="the grader knows A4C"):
        evaluate("random", "", EvaluationConfig(view="KLX", starts=2), abdomen, heart)


def test_an_organ_of_another_package_registers_its_tasks(tmp_path, monkeypatch):
    made = "racines_data.phantom.abdomen:abdomen"
    install(tmp_path, "livers", {"racines.anatomies": {"liver": made}})
    monkeypatch.syspath_prepend(str(tmp_path))
    ids = racines_envs.register_tasks("liver", ("GB",))
    try:
        assert ids == ["racines/liver-GB-v0"]
        phantom = PhantomConfig(anatomy="liver", block=BlockConfig(voxel=0.004))
        core = gymnasium.make(ids[0], phantom=phantom, **SETTINGS).unwrapped.core
        assert (core.task.anatomy, core.task.target, core.task.id) == ("liver", 2, ids[0])
        assert Task("KLX", anatomy=made).target == 0  # or by module and function
    finally:
        del gymnasium.registry[ids[0]]
