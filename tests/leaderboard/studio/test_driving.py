"""Driving by hand: an episode follows from its session alone, and visitors do not meet."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import torch
from PIL import ImageColor

from racines_data.errors import RacinesError
from racines_data.plotting import TRUTH
from racines_envs.agents.planner import PlannerAgent
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_leaderboard.studio import driving, worlds
from racines_leaderboard.studio import scene as scenes
from racines_leaderboard.studio.driving import Lives, begin
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.worlds import FIXED, SEEDED
from tests.envs.fakes import FakeGrader, FakePhantom

ACTIONS = (0, 0, 3, 5, 6, 9, 12, 4)


@pytest.fixture
def phantom(monkeypatch):
    phantom = FakePhantom()
    monkeypatch.setattr(worlds, "load_phantom", lambda place, anatomy: phantom)
    monkeypatch.setattr(worlds, "load_grader", lambda place, labels, tier: FakeGrader())
    return phantom


def lives(sessions=8):
    return Lives(Place(data=None, max_sessions=sessions))


def drive(kept, session, actions=ACTIONS):
    for action in actions:
        session, scene = kept.step(session, action, True)
    return session, scene


def test_buttons_do_what_the_environment_does(phantom):
    session, scene = drive(lives(), begin("SC", FIXED, 3))
    core = make_core("SC", phantom=phantom, observation="image", reward="oracle")
    core.reset(evaluation_seeds(4)[-1:])
    for action in ACTIONS:
        core.step(torch.tensor([action]))
    np.testing.assert_array_equal(scene.image, core.picture()[0].numpy())
    assert scene.wrench == tuple(core.state.wrench[0].tolist())
    assert session.actions == ACTIONS and scene.step == len(ACTIONS)
    p, grade = FakeGrader().probabilities_and_grade(core.picture())
    assert scene.curves[0].grades[-1] == pytest.approx(float(grade[0]))
    assert scene.curves[0].probabilities[-1] == pytest.approx(float(p[0, 1]))
    assert [len(curve.grades) for curve in scene.curves] == [9, 9]


def test_an_environment_that_was_given_up_is_made_again(phantom):
    kept, narrow = lives(), lives(sessions=1)
    one, other = begin("SC", FIXED, 0), begin("PL", SEEDED, 77)
    for action in ACTIONS:
        one, wide_scene = kept.step(one, action, True)
    one, other = begin("SC", FIXED, 0), other
    for action in ACTIONS:
        one, scene = narrow.step(one, action, True)
        other, _ = narrow.step(other, 12, True)
    assert len(narrow) == 1
    np.testing.assert_array_equal(scene.image, wide_scene.image)
    assert scene.curves == wide_scene.curves and scene.refused == wide_scene.refused
    assert other.actions == (12,) * len(ACTIONS)


def test_two_visitors_have_episodes_of_their_own(phantom):
    kept = lives()
    one, other = begin("SC", FIXED, 0), begin("SC", FIXED, 0)
    assert one.token != other.token
    one, moved = drive(kept, one)
    assert kept.look(other, True).step == 0 and moved.step == len(ACTIONS)
    assert (kept.look(other, True).image != moved.image).any()


def test_what_the_state_says_counts(phantom):
    """A stale state, as of a page that was left open, is honoured and not mixed with a newer."""
    kept, session = lives(), begin("SC", FIXED, 0)
    drive(kept, session)
    scene = kept.look(session, False)
    assert scene.step == 0
    again, scene = kept.step(session, 0, False)
    assert again.actions == (0,) and scene.step == 1


def test_hidden_truth_is_nowhere(phantom):
    kept, session = lives(), begin("SC", FIXED, 0)
    hidden, shown = kept.look(session, False), kept.look(session, True)
    assert hidden.truth is None and [curve.name for curve in hidden.curves] == ["grader"]
    assert "true view" not in scenes.image_panel(hidden)
    assert "true view" in scenes.image_panel(shown)
    green = ImageColor.getrgb(TRUTH)
    assert green in set(shown.above.getdata()) and green not in set(hidden.above.getdata())


def test_an_episode_ends_with_its_reason_and_takes_no_further_step(phantom):
    kept, session = lives(), begin("SC", FIXED, 1)
    core = make_core("SC", phantom=phantom, observation="params", reward="oracle")
    planner = PlannerAgent()
    planner.attach(core)
    seen = core.reset(evaluation_seeds(2)[-1:])
    while not bool(core.state.done[0]):
        action = planner.act(seen, core.decision_seeds())
        seen = core.step(action).observation
        session, scene = kept.step(session, int(action), False)
    assert scene.ended == "SC was held for 3 steps in a row" and scene.success
    assert "The episode is over" in scenes.image_panel(scene)
    after, scene = kept.step(session, 0, False)
    assert after == session and scene.step == len(session.actions)


def test_refused_steps_are_counted_and_the_force_stays_in_its_limit(phantom):
    kept, session = lives(), begin("SC", FIXED, 0)
    for _ in range(30):
        session, scene = kept.step(session, 4, False)  # press
    assert sum(scene.refused) > 0 and scene.force <= scene.limit
    assert f"<b>{scene.refused[1]}</b> by force" in scenes.state_line(scene)


@pytest.mark.parametrize(
    ("task", "kind", "number"),
    [
        ("XX", FIXED, 0),
        (["SC"], FIXED, 0),
        ("SC", "any", 0),
        ("SC", FIXED, 100),
        ("SC", FIXED, -1),
        ("SC", FIXED, 1.5),
        ("SC", FIXED, float("nan")),
        ("SC", FIXED, "0"),
        ("SC", FIXED, True),
        ("SC", FIXED, None),
        ("SC", SEEDED, 2**31),
        ("SC", SEEDED, float("inf")),
    ],
)
def test_what_was_not_offered_is_refused(task, kind, number):
    with pytest.raises(RacinesError):
        begin(task, kind, number)


def test_the_drawings_are_whole_and_say_the_force(phantom):
    kept, session = lives(), begin("SC", FIXED, 0)
    _, scene = drive(kept, session)
    page = scenes.side_panel(scene)
    drawings = [part.split("</svg>")[0] + "</svg>" for part in page.split("<svg")[1:]]
    trees = [ElementTree.fromstring("<svg" + drawing) for drawing in drawings]
    assert len(trees) == 3
    bar = trees[0].findall("rect")[1]
    full = scenes.RIGHT - scenes.LEFT
    share = float(bar.attrib["width"]) / full
    assert share == pytest.approx(scene.force / scene.limit / scenes.FULL_FORCE, abs=1e-3)
    for tree in trees[1:]:
        lines = tree.findall("polyline")
        assert [len(line.attrib["points"].split()) for line in lines] == [9, 9]


def test_an_arm_may_carry_the_probe():
    pytest.importorskip("pytorch_kinematics")
    assert driving.robots() == ("free", "ur5e")
    kept = Lives(Place(data=None))
    free, carried = begin("SC", FIXED, 0), begin("SC", FIXED, 0, "ur5e")
    free, _ = kept.step(free, 0, True)
    carried, scene = kept.step(carried, 0, True)
    assert carried.start.robot == "ur5e" and scene.step == 1
    arm, alone = kept.look(carried, True), kept.look(free, True)
    np.testing.assert_array_equal(arm.image, alone.image)
    assert arm.above != alone.above  # the arm is drawn
    with pytest.raises(RacinesError, match="robot: 'kuka' was not offered"):
        begin("SC", FIXED, 0, "kuka")
