"""The TorchRL environment."""

from dataclasses import replace

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from racines_envs import ScanEnv
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core

KEYS = {"image": {"image"}, "params": {"params"}, "multimodal": {"image", "params"}}


@pytest.mark.parametrize("view", ["A4C", "SC", "PL", "PSAV", "PSMV"])
@pytest.mark.parametrize("observation", ["image", "params", "multimodal"])
def test_check_env_specs_passes(phantom, grader, view, observation):
    for reward in ("paper", "oracle"):
        env = ScanEnv(
            view, 3, phantom=phantom, grader=grader, observation=observation, reward=reward
        )
        check_env_specs(env, break_when_any_done="both")
        assert set(env.observation_spec.keys()) == KEYS[observation] | {"info"}


def test_a_rollout_is_the_cores(phantom):
    env = ScanEnv("SC", 4, phantom=phantom, observation="multimodal", reward="oracle", seed=9)
    data = env.rollout(20, break_when_any_done=False)
    core = make_core("SC", 4, phantom=phantom, observation="multimodal", reward="oracle")
    first = core.reset(seed=9)
    assert torch.equal(data["params"][:, 0], first["params"])
    for t in range(20):
        out = core.step(data["action"][:, t])
        assert torch.equal(out.observation["image"], data["next", "image"][:, t, 0])
        assert torch.equal(out.reward, data["next", "reward"][:, t, 0])
        if bool(core.state.done.any()):
            break


def test_ended_rows_start_again_and_others_go_on(phantom):
    env = ScanEnv("SC", 3, phantom=phantom, observation="params", reward="oracle", seed=0)
    data = env.rollout(205, break_when_any_done=False)
    done = data["next", "done"][..., 0]
    assert bool(done.any())
    for row, t in done.nonzero().tolist():
        if t + 1 < 205:
            assert data["next", "info", "steps"][row, t + 1, 0] == 1
            assert not torch.equal(data["params"][row, t + 1], data["next", "params"][row, t])
    both = data["next", "terminated"] | data["next", "truncated"]
    assert torch.equal(both, data["next", "done"])


def test_an_episode_that_is_cut_has_not_ended(phantom):
    task = replace(get_task("SC"), max_steps=3)
    env = ScanEnv(task, 2, phantom=phantom, observation="params", reward="oracle", seed=0)
    last = env.rollout(3, break_when_any_done=False)["next"][:, -1]
    assert bool(last["truncated"].all()) and bool(last["done"].all())
    assert not bool(last["terminated"].any())


def test_seeds_decide_the_episodes(phantom):
    def first(seed):
        env = ScanEnv("SC", 2, phantom=phantom, observation="params", reward="oracle", seed=seed)
        return env.reset()["params"]

    assert torch.equal(first(1), first(1)) and not torch.equal(first(1), first(2))
