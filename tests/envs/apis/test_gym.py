"""Gymnasium: one environment, the vector environment, and that they are the same."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_to_euler
from racines_data.views import VIEWS
from racines_envs.apis.gym_env import GymScanEnv
from racines_envs.apis.rendering import compose
from tests.variants import crossed

ID = "racines_envs:racines/SC-v0"
OBSERVATIONS = ("image", "params", "multimodal")


def make(phantom, observation="params", reward="oracle", view="SC", **more):
    return gymnasium.make(
        f"racines_envs:racines/{view}-v0",
        phantom=phantom,
        observation=observation,
        reward=reward,
        **more,
    )


@pytest.mark.parametrize(
    ("view", "observation", "reward"), crossed(VIEWS, OBSERVATIONS, ["paper", "oracle", "shaped"])
)
def test_check_env_passes_without_warnings(phantom, grader, view, observation, reward):
    env = make(phantom, observation, reward, view, grader=grader, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
        check_env(make(phantom, observation, reward, view, grader=grader).unwrapped)


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize(
    ("mode", "observation"),
    [
        *((AutoresetMode.NEXT_STEP, observation) for observation in OBSERVATIONS),
        (AutoresetMode.SAME_STEP, "params"),
        (AutoresetMode.SAME_STEP, "multimodal"),
        (AutoresetMode.DISABLED, "params"),
    ],
)
def test_the_vector_environment_equals_gymnasiums_own_on_the_same_seeds(phantom, mode, observation):
    ours = gymnasium.make_vec(
        ID, num_envs=3, phantom=phantom, observation=observation, reward="oracle",
        autoreset_mode=mode,
    )  # fmt: skip
    theirs = SyncVectorEnv([lambda: make(phantom, observation)] * 3, autoreset_mode=mode)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is mode
    a, b = ours.reset(seed=[7, 90, 8]), theirs.reset(seed=[7, 90, 8])
    rng, ended = np.random.default_rng(0), 0
    for step in range(65):  # past two episodes of thirty steps
        assert _same(a, b), f"step {step}"
        action = np.where([True, False, True], rng.integers(0, 13, 3), 12)
        a, b = ours.step(action), theirs.step(action)
        assert a[0] in ours.observation_space
        done = a[2] | a[3]
        ended += int(done.sum())
        if mode is AutoresetMode.DISABLED and done.any():
            assert _same(a, b)
            options = {"reset_mask": done.copy()}  # Gymnasium takes it out of the options
            a, b = ours.reset(options=dict(options)), theirs.reset(options=dict(options))
    assert ended >= 6
    assert ours.num_envs == 3


def _same(a, b):
    """Tell whether two answers are equal, to the last key, mask and type of number."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, tuple) or (isinstance(a, np.ndarray) and a.dtype == object):
        return len(a) == len(b) and all(_same(*pair) for pair in zip(a, b, strict=True))
    kinds = [getattr(np.asarray(each).dtype, "kind", None) for each in (a, b)]
    return kinds[0] == kinds[1] and np.array_equal(a, b)


@pytest.mark.usefixtures("short_episodes")
def test_a_row_that_is_reset_alone_takes_its_seed_and_leaves_the_others(phantom):
    def make_rows():
        return gymnasium.make_vec(
            ID, num_envs=2, phantom=phantom, observation="params", reward="oracle"
        )

    envs, untouched, other = make_rows(), make_rows(), make_rows()
    for each in (envs, untouched):
        each.reset(seed=0)
        each.step([0, 0])
    seen, infos = envs.reset(seed=40, options={"reset_mask": np.array([False, True])})
    fresh = other.reset(seed=40)[0]
    np.testing.assert_array_equal(seen[1], fresh[1])
    assert infos["_steps"].tolist() == [False, True]
    for step in range(40):  # the first row goes on to the second episode of its own seed
        a, b, c = envs.step([0, 1]), untouched.step([0, 1]), other.step([0, 1])
        np.testing.assert_array_equal(a[0][0], b[0][0], err_msg=f"step {step}")
        np.testing.assert_array_equal(a[0][1], c[0][1], err_msg=f"step {step}")


def test_modes_and_masks_that_are_none_are_refused(phantom):
    settings = {"phantom": phantom, "observation": "params", "reward": "oracle"}
    with pytest.raises(RacinesError, match="autoreset_mode 'Never': choose one of 'NextStep'"):
        gymnasium.make_vec(ID, num_envs=2, autoreset_mode="Never", **settings)
    envs = gymnasium.make_vec(ID, num_envs=2, autoreset_mode="SameStep", **settings)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    for mask in ([True], [0, 1], [False, False], "all"):
        with pytest.raises(RacinesError, match="reset_mask"):
            envs.reset(options={"reset_mask": mask})
    with pytest.raises(RacinesError, match="unknown reset option 'reset_mask'"):
        make(phantom).reset(options={"reset_mask": np.array([True])})


@pytest.mark.usefixtures("short_episodes")
def test_without_autoreset_a_step_after_the_end_is_refused(phantom):
    envs = gymnasium.make_vec(
        ID, num_envs=2, phantom=phantom, observation="params", reward="oracle",
        autoreset_mode="Disabled",
    )  # fmt: skip
    envs.reset(seed=0)
    with pytest.raises(RacinesError, match="has ended after 30 steps: call reset"):
        for _ in range(40):
            envs.step([12, 12])


def test_images_are_channels_last(phantom):
    seen, _ = make(phantom, "image").reset(seed=0)
    assert seen.shape == (128, 128, 1) and seen.dtype == np.uint8


def test_render_is_the_picture_of_the_core_and_follows_the_episode(phantom):
    env = make(phantom, render_mode="rgb_array")
    with pytest.raises(RacinesError, match="render before reset"):
        env.unwrapped.render()
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (540, 960, 3) and first.dtype == np.uint8
    np.testing.assert_array_equal(first, compose(env.unwrapped.core))
    env.step(0)
    second = env.render()
    assert (first != second).any()
    # A path and a trace of two steps, which the present state alone does not show.
    assert (second != compose(env.unwrapped.core)).any()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), first)


def test_vector_render_gives_the_single_environments_picture_a_row(phantom):
    env = gymnasium.make_vec(
        ID, num_envs=2, phantom=phantom, observation="params", reward="oracle",
        render_mode="rgb_array",
    )  # fmt: skip
    with pytest.raises(RacinesError, match="render before reset"):
        env.render()
    env.reset(seed=0)
    env.step(np.array([2, 4]))
    frames = env.render()
    assert len(frames) == 2
    alone = make(phantom, render_mode="rgb_array")
    alone.reset(seed=1)
    alone.step(4)
    np.testing.assert_array_equal(frames[1], alone.render())


def test_without_a_render_mode_nothing_is_drawn(phantom):
    env = make(phantom)
    env.reset(seed=0)
    assert env.unwrapped.render() is None
    assert phantom.rendered == 0


@pytest.mark.parametrize("action", [float("nan"), 1.5, 13, -1, [0, 1], "x", None])
def test_bad_actions_are_refused(phantom, action):
    env = make(phantom).unwrapped
    env.reset(seed=0)
    with pytest.raises(RacinesError, match="action"):
        env.step(action)
    vector = gymnasium.make_vec(
        ID, num_envs=2, phantom=phantom, observation="params", reward="oracle"
    )
    vector.reset(seed=0)
    with pytest.raises(RacinesError, match="action"):
        vector.step([0, action])


def test_seeds_of_a_vector_are_one_integer_or_one_a_row(phantom):
    def make_vec(count):
        return gymnasium.make_vec(
            ID, num_envs=count, phantom=phantom, observation="params", reward="oracle"
        )

    envs = make_vec(2)
    together = envs.reset(seed=7)[0]
    for seeds in ([7, 8], (7, 8), np.array([7, 8]), np.int64(7)):
        np.testing.assert_array_equal(envs.reset(seed=seeds)[0], together)
    for seeds in ([1, None], [1], [0.5, 1.0], "a"):
        with pytest.raises(RacinesError, match="one a row"):
            envs.reset(seed=seeds)
    with pytest.raises(RacinesError, match="at least 1"):
        make_vec(0)


def test_start_pose_option(phantom):
    env = make(phantom)
    target = phantom.target("SC")
    pose = [*target.position[0].tolist(), *matrix_to_euler(target.rotation)[0].tolist()]
    _, info = env.reset(seed=0, options={"pose": pose})
    assert info["position_error"] < 1e-6 and info["success"]
    for options, word in (
        ({"pose": [0.9, *pose[1:]]}, "outside the workspace"),
        ({"pose": pose[:3]}, "shape"),
        ({"pose": ["left"] * 6}, "no numbers"),
        ({"pose": [float("nan"), *pose[1:]]}, "not finite"),
        ({"poes": pose}, "unknown reset option"),
    ):
        with pytest.raises(RacinesError, match=word):
            env.reset(options=options)


def test_missing_grader_and_wrong_names_are_refused(phantom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("racines_models.published.places.CHECKOUT", tmp_path)
    with pytest.raises(RacinesError, match="racines train grader"):
        gymnasium.make(ID, phantom=phantom)
    with pytest.raises(RacinesError, match="render_mode"):
        GymScanEnv("SC", phantom=phantom, render_mode="ansi")
    with pytest.raises(RacinesError, match="phantom"):
        make("a phantom")


def test_an_unseeded_environment_starts_anywhere(phantom):
    starts = [make(phantom).reset()[0] for _ in range(2)]
    assert not np.array_equal(*starts)


def test_infos_are_plain_numbers_of_the_truth(phantom):
    env = make(phantom)
    env.reset(seed=0)
    info = env.step(0)[4]
    assert {"view", "grade", "success", "force", "workspace_hits", "position_error"} <= set(info)
    assert all(isinstance(value, (bool, int, float)) for value in info.values())
