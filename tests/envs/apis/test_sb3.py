"""Stable-Baselines3's `VecEnv`: the same as its own of single environments, row by row."""

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_to_euler
from racines_envs.apis.sb3 import SB3ScanEnv

ID = "racines_envs:racines/SC-v0"
SETTINGS = {"observation": "params", "reward": "oracle"}


def both(phantom, count=3, **settings):
    given = SETTINGS | settings | {"phantom": phantom}
    theirs = DummyVecEnv([lambda: gymnasium.make(ID, **given)] * count)
    return SB3ScanEnv("racines/SC-v0", count, **given), theirs


def same(a, b):
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and np.array_equal(a, b)


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize("observation", ["params", "image", "multimodal"])
def test_it_equals_their_own_of_single_environments(phantom, observation):
    ours, theirs = both(phantom, observation=observation)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    for env in (ours, theirs):
        env.seed(7)
    assert same(ours.reset(), theirs.reset()) and same(ours.reset_infos, theirs.reset_infos)
    rng, ends = np.random.default_rng(0), 0
    for step in range(65):
        action = rng.integers(0, 13, 3)
        a, b = list(ours.step(action)), list(theirs.step(action))
        assert a[1].dtype == b[1].dtype == np.float32
        assert same(a, b), f"step {step}"
        assert same(ours.reset_infos, theirs.reset_infos)
        ends += int(a[2].sum())
        assert all(info["TimeLimit.truncated"] for info, end in zip(a[3], a[2], strict=True) if end)
    assert ends >= 6


def test_an_episode_that_ended_by_hits_was_not_cut(phantom):
    target = phantom.target("SC")
    pose = [*target.position[0].tolist(), *matrix_to_euler(target.rotation)[0].tolist()]
    ours, _ = both(phantom, 2, termination="first_hit")
    ours.set_options({"pose": pose})
    ours.reset()
    _, _, done, infos = ours.step(np.array([12, 12]))
    assert done.all() and infos[0]["success"]
    assert not infos[0]["TimeLimit.truncated"] and "terminal_observation" in infos[0]


def test_rows_are_asked_one_by_one(phantom):
    ours, theirs = both(phantom, render_mode="rgb_array")
    assert ours.render_mode == "rgb_array" and ours.get_attr("render_mode") == ["rgb_array"] * 3
    assert ours.get_attr("num_envs", [0, 2]) == [3, 3]
    assert ours.get_attr("spec")[0].id == "racines/SC-v0"
    assert not ours.has_attr("nothing") and ours.has_attr("action_masks")
    ours.set_attr("note", 5, indices=[1])
    assert ours.get_attr("note", 1) == [5]
    for env in (ours, theirs):
        env.seed(0)
        env.reset()
    alone = ours.env_method("reset", seed=9, indices=1)[0]
    assert same(alone, theirs.env_method("reset", seed=9, indices=1)[0])
    seen = ours.step(np.array([0, 1, 2]))[0]
    assert same(seen, theirs.step(np.array([0, 1, 2]))[0])
    for a, b in zip(ours.get_images(), theirs.get_images(), strict=True):
        np.testing.assert_array_equal(a, b)
    masks = ours.env_method("action_masks")
    assert len(masks) == 3 and masks[0].shape == (13,) and masks[0].dtype == bool
    assert same(ours.env_method("action_masks", indices=[2])[0], masks[2])
    assert ours.env_is_wrapped(gymnasium.Wrapper) == [False] * 3
    ours.set_options([{}, {"pose": [0.0] * 6}, {}])
    with pytest.raises(RacinesError, match="all rows the same names"):
        ours.reset()


@pytest.mark.usefixtures("short_episodes")
def test_ppo_learns_on_it_and_the_monitor_sees_its_episodes(phantom):
    ours, _ = both(phantom, 4)
    model = PPO(
        "MlpPolicy", VecMonitor(ours), n_steps=32, batch_size=64, n_epochs=1, seed=0,
        policy_kwargs={"net_arch": [16]}, device="cpu",
    )  # fmt: skip
    model.learn(256)
    assert len(model.ep_info_buffer or ()) >= 4
    assert all(each["l"] == 30 for each in model.ep_info_buffer or ())
