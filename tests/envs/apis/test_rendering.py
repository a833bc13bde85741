"""The picture of an episode."""

import numpy as np
import pytest
import torch

from racines_envs.apis.rendering import IMAGE, History, compose, describe
from racines_envs.worlds.making import make_core


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
