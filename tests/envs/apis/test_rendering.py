"""The picture of an episode."""

import gymnasium
import numpy as np
import pytest
import torch
from PIL import Image, ImageColor, ImageSequence

from racines_data.plotting import PALE
from racines_envs.apis.rendering import IMAGE, History, compose, describe
from racines_envs.recordings import EpisodeRecorder
from racines_envs.robots.following import ArmRobot
from racines_envs.worlds.making import make_core

BLOCK = (slice(0, 318), slice(IMAGE + 2, None))
"""The views of the block in a picture."""


@pytest.fixture
def core(phantom):
    core = make_core("SC", 2, phantom=phantom, observation="params", reward="oracle")
    core.reset(seed=3)
    return core


def test_the_ultrasound_image_is_in_it(core):
    picture = compose(core, 1)
    shown = picture[1:IMAGE:3, 1:IMAGE:3, 0].astype(float)  # enlarged three times
    assert np.ptp(picture[:IMAGE, :IMAGE], -1).max() == 0  # gray
    truth = core.picture()[1].numpy().astype(float)
    assert np.corrcoef(shown.ravel(), truth.ravel())[0, 1] > 0.99


def test_rows_have_their_own_picture_and_drawing_is_repeatable(core):
    assert (compose(core, 0) != compose(core, 1)).any()
    np.testing.assert_array_equal(compose(core, 0), compose(core, 0))


def test_probe_and_path_move_with_the_steps(core):
    history = History(2)
    history.note(core)
    before = compose(core, 0, history)
    for _ in range(5):
        action = torch.tensor([0, 12])
        core.step(action)
        history.note(core, action)
    after = compose(core, 0, history)
    sides = (slice(0, 320), slice(IMAGE, None))
    assert (before[sides] != after[sides]).any()
    assert history[0].actions == [None, 0, 0, 0, 0, 0]
    assert len(history[1].positions) == 6 and history[1].positions[0] == history[1].positions[5]


def test_a_reset_row_begins_anew_and_an_ended_row_stays(core):
    history = History(2)
    history.note(core)
    core.step(torch.tensor([0, 0]))
    history.note(core, torch.tensor([0, 0]))
    core.reset(mask=torch.tensor([True, False]))
    history.note(core)
    assert len(history[0].positions) == 1 and len(history[1].positions) == 2
    core.state.done[:] = True
    core.step(torch.tensor([0, 0]))
    history.note(core, torch.tensor([0, 0]))
    assert len(history[1].positions) == 2


def test_it_says_view_force_steps_and_errors(core):
    history = History(2)
    history.note(core)
    core.step(torch.tensor([3, 3]))
    history.note(core, torch.tensor([3, 3]))
    words = "\n".join(describe(core, 0, history[0]))
    info = core.info()
    assert "step 1 / 200" in words and "-y" in words
    assert f"force {info['force'][0]:.1f} N of 20 N" in words
    assert f"{info['position_error'][0] * 1e3:.0f} mm" in words
    assert "true view Random" in words


@pytest.mark.parametrize(("observation", "drawn"), [("params", 2), ("image", 0)])
def test_no_image_is_drawn_that_a_step_has_drawn(phantom, observation, drawn):
    """What a picture costs beside lines and words; `make bench` times it."""
    core = make_core("SC", 2, phantom=phantom, observation=observation, reward="oracle")
    core.reset(seed=3)
    before = phantom.rendered
    compose(core)
    assert phantom.rendered - before == drawn


def test_recordings_in_the_place_of_a_phantom_are_drawn_too(tiny_root):
    core = make_core(
        "SC", 1, backend="replay", data=tiny_root, phantom="recorded", observation="image",
        reward="oracle",
    )  # fmt: skip
    core.reset(seed=0)
    history = History(1)
    history.note(core)
    assert compose(core, 0, history).shape == (540, 960, 3)
    assert ("recorded" in describe(core, 0, history[0])[-1]) == bool(core.info()["out_of_support"])


def limbs(picture: np.ndarray) -> int:
    """Count the pixels of the views that have the arm's colour and such neighbours all around.

    The workspace has the same colour, but lines of one pixel.
    """
    off = np.abs(picture[BLOCK].astype(int) - ImageColor.getrgb(PALE)).max(-1)
    rows, columns = (slice(1, -1), slice(2, None), slice(None, -2)), off < 12
    return int(np.all([columns[down, across] for down in rows for across in rows], 0).sum())


def test_an_arm_is_drawn_in_the_picture_and_in_every_frame_of_the_video(phantom, tmp_path):
    pytest.importorskip("pytorch_kinematics")
    made = {"phantom": phantom, "observation": "params", "reward": "oracle"}
    free = make_core("SC", 1, **made)
    free.reset(seed=3)
    assert limbs(compose(free)) == 0
    env = gymnasium.make(
        "racines_envs:racines/SC-v0", **made, robot="ur5e", render_mode="rgb_array"
    )
    recorder = EpisodeRecorder(env, tmp_path)
    recorder.reset(seed=3)
    core = env.unwrapped.core
    assert isinstance(core.robot, ArmRobot)
    picture = compose(core)
    assert limbs(picture) > 500
    np.testing.assert_array_equal(picture[BLOCK], env.render()[BLOCK])
    joints = core.state.joints.clone()
    core.state.joints[:] = joints + 0.3
    moved = compose(core)
    core.state.joints[:] = joints
    assert limbs(moved) > 500 and (moved[BLOCK] != picture[BLOCK]).any()  # drawn as it stands
    for action in (0, 2, 4):
        recorder.step(action)
    recorder.close()
    with Image.open(recorder.written[0].with_suffix(".gif")) as video:
        frames = [np.asarray(each.convert("RGB")) for each in ImageSequence.Iterator(video)]
    assert len(frames) == 4 and min(map(limbs, frames)) > 500
