"""The same promises on the phantom itself."""

import warnings

import gymnasium
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

from racines_data.views import VIEWS
from racines_envs import ScanEnv
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from tests.variants import crossed


@pytest.mark.parametrize(
    "view", [v if v == "PSMV" else pytest.param(v, marks=pytest.mark.thorough) for v in VIEWS]
)
def test_every_view_can_be_reached_and_is_not_reached_by_chance(real_phantom, view):
    """The planner's steps are the paper's agent's: 16 to 32 from its start points."""
    core = make_core(view, 300, observation="params", reward="oracle", phantom=real_phantom)
    assert bool(real_phantom.workspace.contains(core.target).all())
    seeds = evaluation_seeds(300)
    core.reset(seeds)
    assert not bool(core.info()["success"].any())
    assert core.info()["force"].max() <= core.task.force_limit
    final = rollout(core, PlannerAgent(), seeds).final
    assert final["success"].mean() >= 0.98
    assert 15 <= float(torch.tensor(final["steps"]).median()) <= 30
    assert rollout(core, RandomAgent(), seeds).final["success"].mean() < 0.1


@pytest.mark.parametrize(("view", "observation"), crossed(VIEWS, ["image", "params", "multimodal"]))
def test_the_checkers_pass(real_phantom, view, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(
            f"racines_envs:racines/{view}-v0", phantom=real_phantom, observation=observation,
            reward="oracle", render_mode="rgb_array",
        )  # fmt: skip
        check_env(env.unwrapped)
    check_env_specs(
        ScanEnv(view, 2, phantom=real_phantom, observation=observation, reward="oracle")
    )


def test_a_batch_equals_single_environments(real_phantom):
    settings = {"observation": "multimodal", "reward": "oracle", "phantom": real_phantom}
    together = make_core("SC", 3, **settings)
    alone = [make_core("SC", 1, **settings) for _ in range(3)]
    together.reset(seed=0)
    for row, core in enumerate(alone):
        core.reset(seed=row)
    generator = torch.Generator().manual_seed(0)
    for action in torch.randint(0, 13, (12, 3), generator=generator):
        batch = together.step(action, autoreset=True)
        for row, core in enumerate(alone):
            single = core.step(action[row : row + 1], autoreset=True)
            for key, value in single.observation.items():
                assert torch.equal(value[0], batch.observation[key][row]), key
            assert torch.equal(single.reward[0], batch.reward[row])


def test_the_default_phantom_is_shared():
    make = lambda: gymnasium.make(  # noqa: E731
        "racines_envs:racines/SC-v0", observation="params", reward="oracle"
    )
    assert make().unwrapped.core.phantom is make().unwrapped.core.phantom
