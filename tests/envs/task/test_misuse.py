"""Misuse ends at once and says what was wrong."""

import gymnasium
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_to_euler
from racines_envs.task.actions import IDLE
from racines_envs.worlds.making import make_core
from racines_models.protocol import Judge


def core_of(phantom, **settings):
    settings = {"observation": "image", "reward": "oracle", "phantom": phantom} | settings
    return make_core("SC", 2, **settings)


class Source:
    """Draws what it is told to."""

    def __init__(self, drawn):
        self.drawn = drawn

    def generate(self, parameters, seed):
        return self.drawn


@pytest.mark.parametrize(
    ("drawn", "word"),
    [
        (torch.full((2, 128, 128), float("nan")), "NaN or infinity"),
        (torch.zeros(2, 128, 128), "gave torch.float32: give uint8"),
        (torch.zeros(2, 64, 64, dtype=torch.uint8), r"shape \(2, 64, 64\) for 2 poses"),
        (torch.zeros(1, 128, 128, dtype=torch.uint8), r"shape \(1, 128, 128\) for 2 poses"),
        ([[0]], "gave list: give a torch.Tensor"),
    ],
)
def test_a_generator_that_draws_no_gray_images_is_named(phantom, drawn, word):
    with pytest.raises(RacinesError, match=rf"backend Source: generate .*{word}"):
        core_of(phantom, backend=Source(drawn)).reset(seed=0)
    unseen = core_of(phantom, backend=Source(drawn), observation="params")
    unseen.reset(seed=0)
    with pytest.raises(RacinesError, match="backend Source"):
        unseen.picture()


class Guess(Judge):
    """Judges as it is told to."""

    def __init__(self, p, grade):
        self.p, self.grade = p, grade

    def probabilities_and_grade(self, images):
        return self.p, self.grade


@pytest.mark.parametrize(
    ("p", "grade", "word"),
    [
        (torch.ones(2, 4), torch.ones(2), r"probabilities \(2, 4\).*give \(2, 6\) and \(2,\)"),
        (torch.ones(2, 6), torch.ones(2, 1), r"grades \(2, 1\)"),
        (torch.full((2, 6), float("nan")), torch.ones(2), "probabilities: row 0 is NaN"),
        (torch.ones(2, 6), torch.tensor([1.0, float("inf")]), "grades: row 1 is NaN or infinite"),
    ],
)
def test_a_grader_that_judges_otherwise_is_named(phantom, p, grade, word):
    core = core_of(phantom, reward="paper", grader=Guess(p, grade))
    with pytest.raises(RacinesError, match=rf"grader Guess: .*{word}"):
        core.reset(seed=0)


def test_a_step_after_the_end_is_refused_where_that_is_asked_for(phantom):
    core = core_of(phantom, observation="params", termination="first_hit")
    core.reset(pose=type(core.target)(*(x.expand(2, *x.shape[1:]) for x in core.target)))
    idle = torch.full((2,), IDLE)
    assert bool(core.step(idle, strict=True).terminated.all())
    with pytest.raises(RacinesError, match="row 0 has ended after 1 steps: call reset"):
        core.step(idle, strict=True)
    assert core.state.steps.tolist() == [1, 1]
    core.step(idle)  # not asked for: rows that ended stand still
    assert core.step(idle, autoreset=True).reward.tolist() == [0, 0]
    core.reset(seed=1)
    core.step(idle, strict=True)


def test_a_step_before_the_first_reset_is_refused(phantom):
    with pytest.raises(RacinesError, match="call reset first"):
        core_of(phantom).step(torch.full((2,), IDLE))


def test_a_gymnasium_environment_refuses_a_step_after_the_end_and_a_vector_starts_anew(phantom):
    settings = {"phantom": phantom, "observation": "params", "reward": "oracle"}
    settings["termination"] = "first_hit"
    target = phantom.target("SC")
    pose = [*target.position[0].tolist(), *matrix_to_euler(target.rotation)[0].tolist()]
    env = gymnasium.make("racines_envs:racines/SC-v0", **settings).unwrapped
    _, info = env.reset(seed=0)
    assert info["view_position_error"] > 0
    assert "view_position_error" not in env.step(IDLE)[4]
    env.reset(seed=0, options={"pose": pose})
    _, _, ended, _, info = env.step(IDLE)
    assert ended and info["view_position_error"] == 0
    with pytest.raises(RacinesError, match="ended after 1 steps: call reset"):
        env.step(IDLE)
    envs = gymnasium.make_vec("racines_envs:racines/SC-v0", num_envs=2, **settings)
    envs.reset(seed=0, options={"pose": pose})
    assert envs.step([IDLE, IDLE])[2].all()
    assert envs.step([IDLE, IDLE])[4]["steps"].tolist() == [0, 0]


def test_what_stands_for_a_world_or_a_judge_inherits_its_protocol(phantom):
    class Block:
        """Has what a phantom has, but not what `World` adds."""

        target, judge, wrench = phantom.target, phantom.judge, phantom.wrench
        render, truth, workspace = phantom.render, phantom.truth, phantom.workspace

    with pytest.raises(RacinesError, match=r"racines_data\.world\.World"):
        core_of(Block())

    class Mute:
        probabilities_and_grade = None

    with pytest.raises(RacinesError, match=r"racines_models\.protocol\.Judge"):
        core_of(phantom, reward="paper", grader=Mute())


def test_a_judge_that_tells_its_labels_is_held_to_them(phantom):
    judge = Guess(torch.zeros(2, 6), torch.zeros(2))
    core_of(phantom, reward="paper", grader=judge)  # tells none: it may know any
    judge.labels = ("KLX", "Random")
    with pytest.raises(RacinesError, match="the grader knows KLX, Random, the heart has A4C"):
        core_of(phantom, reward="paper", grader=judge)
