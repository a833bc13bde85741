"""Tasks as LeRobot evaluates them: names, shapes, base-frame velocities, ends."""

import importlib.util

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from racines_data.errors import RacinesError
from racines_data.schema import PARAMETERS
from racines_envs.apis.lerobot import LeRobotEnv, make_env, write_envhub
from racines_envs.task.tasks import get_task


@pytest.fixture
def env(phantom):
    return LeRobotEnv("SC", phantom=phantom)


def test_it_is_an_environment_of_lerobots_names(env):
    check_env(env, skip_render_check=True)
    seen, info = env.reset(seed=1, options={"lerobot_new_rollout": True})
    assert seen["pixels"]["ultrasound"].shape == (128, 128, 3)
    assert seen["pixels"]["ultrasound"].dtype == np.uint8
    assert seen["agent_pos"].shape == (len(PARAMETERS),) and info["is_success"] is False
    assert env._max_episode_steps == get_task("SC").max_steps and "SC" in env.task_description


def test_a_velocity_is_the_base_frames(env):
    env.reset(seed=1)
    core = env._env.core
    before = core.state.position.clone()
    env.step(np.array([0.01, -0.005, 0.0, 0.0, 0.0, 0.0], np.float32))
    moved = (core.state.position - before)[0]
    assert torch.allclose(moved, torch.tensor([0.001, -0.0005, 0.0]).to(moved), atol=1e-6)


def test_what_is_too_fast_is_cut_in_the_probes_frame(env):
    env.reset(seed=1)
    core = env._env.core
    before, turned = core.state.position.clone(), core.state.rotation[0].clone()
    env.step(env.action_space.high)
    along = (core.state.position - before)[0] @ turned.to(before)
    assert float(along.abs().max()) <= 0.003 + 1e-6


def test_a_hub_folder_gets_vector_environments(phantom):
    made = make_env(n_envs=2, views=("SC", "PL"), phantom=phantom)
    assert list(made) == ["racines"] and list(made["racines"]) == [0, 1]
    rows = made["racines"][0]
    rows.reset(seed=[3, 4])
    assert rows.call("_max_episode_steps") == (200, 200)
    seen, *_ = rows.step(np.zeros((2, 6), np.float32))
    assert seen["pixels"]["ultrasound"].shape == (2, 128, 128, 3)
    for _ in range(200):
        info = rows.step(np.zeros((2, 6), np.float32))[-1]
        if "final_info" in info:
            break
    assert info["final_info"]["is_success"].shape == (2,)


def test_a_folder_for_the_hub_makes_its_tasks(tmp_path):
    made = write_envhub(tmp_path / "hub", ["SC", "PL-patients"])
    assert made["tasks"] == ["SC", "PL-patients"]
    spec = importlib.util.spec_from_file_location("hub_env", tmp_path / "hub/env.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.VIEWS == ("SC", "PL-patients") and callable(module.make_env)
    for views, message in (([], "name a task"), (["XX"], "unknown view 'XX'")):
        with pytest.raises(RacinesError, match=message):
            write_envhub(tmp_path / "none", views)
    assert not (tmp_path / "none").exists()
    with pytest.raises(RacinesError, match="hub"):
        write_envhub(tmp_path / "hub", ["SC"])
