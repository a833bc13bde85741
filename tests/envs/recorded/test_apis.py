"""`racines/Replay-v0` in Gymnasium and TorchRL."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

from racines_data.errors import RacinesError
from racines_envs import ScanEnv
from racines_envs.task.names import REPLAY_ID
from racines_envs.worlds.recorded import ReplayConfig, open_recordings

ID = f"racines_envs:{REPLAY_ID}"


@pytest.mark.parametrize("observation", ["image", "params", "multimodal"])
@pytest.mark.parametrize("beyond", ["refuse", "mask"])
def test_check_env_passes_without_warnings(tiny_root, observation, beyond):
    env = gymnasium.make(
        ID, data=tiny_root, view="SC", observation=observation, beyond=beyond,
        render_mode="rgb_array",
    )  # fmt: skip
    assert env.unwrapped.core.task.id == REPLAY_ID
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    seen, info = env.reset(seed=0)
    assert env.render().shape == (540, 960, 3)
    assert info["frame_distance"] == 0.0 and not info["success"]
    if beyond == "mask":
        action = env.action_space.sample(seen["action_mask"])
        _, _, _, _, info = env.step(action)
        assert info["workspace_hits"] == 0


@pytest.mark.parametrize("beyond", ["refuse", "mask"])
def test_the_vector_environment_equals_single_ones(tiny_root, beyond):
    settings = {"view": "SC", "observation": "multimodal", "beyond": beyond, "max_steps": 15}
    envs = gymnasium.make_vec(ID, num_envs=3, data=tiny_root, **settings)
    ones = [gymnasium.make(ID, data=tiny_root, **settings) for _ in range(3)]
    many, _ = envs.reset(seed=5)
    alone = [env.reset(seed=5 + row)[0] for row, env in enumerate(ones)]
    rng = np.random.default_rng(0)
    for _ in range(15):
        for row, seen in enumerate(alone):
            for name, value in seen.items():
                np.testing.assert_array_equal(many[name][row], value)
        action = rng.integers(0, 13, 3)
        many, rewards, _, cut, _ = envs.step(action)
        steps = [env.step(int(each)) for env, each in zip(ones, action, strict=True)]
        alone = [step[0] for step in steps]
        assert rewards.tolist() == [step[1] for step in steps]
    assert cut.all()


def test_open_recordings_serve_environments_as_they_are(tiny_root):
    world = open_recordings(tiny_root, "SC")
    env = gymnasium.make(ID, data=world, observation="params")
    assert env.unwrapped.core.phantom is world
    env.reset(seed=0)
    with pytest.raises(RacinesError, match="recordings that are open have their settings: beyond"):
        gymnasium.make(ID, data=world, beyond="mask")


@pytest.mark.parametrize("beyond", ["refuse", "mask"])
def test_torchrl_specs_hold(tiny_root, beyond):
    world = open_recordings(tiny_root, "SC", ReplayConfig(beyond=beyond))
    env = ScanEnv("SC", 4, phantom=world, observation="multimodal")
    check_env_specs(env)
    data = env.rollout(5)
    assert data["image"].shape == (4, 5, 1, 128, 128)
    assert ("action_mask" in data) == (beyond == "mask")
    one, two = (
        ScanEnv("SC", 4, phantom=world, observation="image", seed=3).reset() for _ in range(2)
    )
    assert torch.equal(one["image"], two["image"])


def test_wrong_settings_are_named(tiny_root):
    with pytest.raises(RacinesError, match=r"replay\.reach: 'far' is str, expected"):
        gymnasium.make(ID, data=tiny_root, view="SC", reach="far")
    with pytest.raises(RacinesError, match="name the view: its frames show A4C, SC"):
        gymnasium.make(ID, data=tiny_root)
    with pytest.raises(RacinesError, match="no dataset here"):
        gymnasium.make(ID, data="nowhere", view="SC")
