"""Tasks, actions, starts."""

import dataclasses
import math

import gymnasium
import pytest
import torch

import racines_envs  # noqa: F401  registers the tasks
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, matmul3
from racines_data.views import VIEWS
from racines_envs.task.actions import ACTIONS, IDLE, ActionTable, check_actions
from racines_envs.task.starts import draw_starts, evaluation_seeds, validation_seeds
from racines_envs.task.tasks import TASKS, Task, get_task
from tests.envs.fakes import FakePhantom


def test_one_task_a_view_is_registered():
    assert tuple(name for name, task in TASKS.items() if task.anatomy == "heart") == VIEWS
    for name, task in TASKS.items():
        organ = {} if task.anatomy == "heart" else {"anatomy": task.anatomy}
        assert gymnasium.spec(task.id).kwargs == {"view": task.view} | organ
        assert get_task(name) == get_task(task.view, task.anatomy) == task
        assert (task.termination, task.hits, task.max_steps) == ("k_hits", 3, 200)


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"termination": "never"}, "termination"), ({"hits": 0}, "hits"), ({"view": "XX"}, "view")],
)
def test_impossible_tasks_are_refused(changes, word):
    with pytest.raises(RacinesError, match=word):
        dataclasses.replace(get_task("SC"), **changes)


def test_actions_move_along_the_probes_own_axes(phantom):
    table = ActionTable.make(0.003, 0.06, "cpu")
    start = phantom.target("SC")
    for index, name in enumerate(ACTIONS):
        moved = table.move(start, torch.tensor([index]))
        shift = (moved.position - start.position)[0]
        angle = geodesic(moved.rotation, start.rotation).item()
        if name == "idle":
            assert shift.norm() == 0 and angle == 0
        elif "r" in name:
            assert shift.norm() == 0 and angle == pytest.approx(0.06, rel=1e-3)
        else:
            axis = start.rotation[0, :, "xyz".index(name[1])] * (
                0.003 if name[0] == "+" else -0.003
            )
            assert torch.allclose(shift, axis, atol=1e-7) and angle == 0


def test_opposite_actions_cancel_and_many_turns_stay_rotations():
    table = ActionTable.make(0.003, 0.06, "cpu")
    pose = Pose(torch.zeros(1, 3), torch.eye(3).unsqueeze(0))
    for action in torch.randint(0, 12, (3000,), generator=torch.Generator().manual_seed(1)):
        pose = table.move(pose, action.view(1))
    gram = matmul3(pose.rotation.transpose(1, 2), pose.rotation)
    assert torch.allclose(gram, torch.eye(3), atol=1e-6)
    assert torch.linalg.det(pose.rotation).item() == pytest.approx(1.0, abs=1e-5)
    there = table.move(table.move(pose, torch.tensor([6])), torch.tensor([7]))
    assert geodesic(there.rotation, pose.rotation).item() < 1e-5


@pytest.mark.parametrize(
    "action",
    [
        torch.tensor([float("nan"), 0.0]),
        torch.tensor([0.0, 1.0]),
        torch.tensor([0, 13]),
        torch.tensor([-1, 0]),
        torch.tensor([0]),
        torch.tensor([True, False]),
    ],
)
def test_actions_that_are_not_integers_0_to_12_are_refused(action):
    with pytest.raises(RacinesError, match="action"):
        check_actions(action, 2)
    assert check_actions(torch.tensor([0, IDLE], dtype=torch.int32), 2).dtype == torch.int64


def test_starts_keep_their_distances_and_limits(phantom):
    task = get_task("PSAV")
    target = phantom.target(task.view)
    starts = draw_starts(task, phantom, target, evaluation_seeds(500))
    assert bool(phantom.workspace.contains(starts).all())
    shift = starts.position - target.position
    across, angle = shift[:, :2].norm(dim=1), geodesic(starts.rotation, target.rotation)
    assert across.min() >= task.start_distance[0] - 1e-6
    assert across.max() <= task.start_distance[1] + 1e-6
    assert angle.min() >= task.start_angle[0] - 1e-3
    assert angle.max() <= task.start_angle[1] + 1e-3
    # Spread over the ranges, not stuck at an end.
    assert across.std() > 0.2 * (task.start_distance[1] - task.start_distance[0])
    assert bool((phantom.judge(starts).membership[:, task.target] < 0.5).all())


def test_an_episode_does_not_start_in_the_view_though_a_third_of_the_draws_show_it(phantom):
    task = dataclasses.replace(get_task("SC"), start_distance=(0.0, 0.02), start_angle=(0.0, 0.6))
    seeds, target = evaluation_seeds(300), phantom.target("SC")
    starts = draw_starts(task, phantom, target, seeds)
    assert bool((phantom.judge(starts).membership[:, task.target] < 0.5).all())
    for row in range(20):  # whichever of its draws it took
        alone = draw_starts(task, phantom, target, seeds[row : row + 1])
        assert torch.equal(alone.position[0], starts.position[row])


def test_a_start_depends_on_its_own_seed_alone(phantom):
    task, seeds = get_task("SC"), evaluation_seeds(20)
    target = phantom.target("SC")
    together = draw_starts(task, phantom, target, seeds)
    alone = draw_starts(task, phantom, target, seeds[7:8])
    assert torch.equal(together.position[7:8], alone.position)
    assert torch.equal(together.rotation[7:8], alone.rotation)


def test_start_sets_are_fixed_and_apart():
    assert torch.equal(evaluation_seeds(5), evaluation_seeds(9)[:5])
    assert not torch.equal(evaluation_seeds(5), evaluation_seeds(5, seed=1))
    assert not set(evaluation_seeds(500).tolist()) & set(validation_seeds(500).tolist())


def test_a_start_that_finds_no_place_falls_back_to_the_nominal_pose():
    class Nowhere(FakePhantom):
        def __init__(self):
            super().__init__()
            object.__setattr__(self.workspace, "contains", lambda pose: pose.position[:, 0] < 0)

    phantom = Nowhere()
    start = draw_starts(Task("SC"), phantom, phantom.target("SC"), evaluation_seeds(3))
    assert torch.equal(start.position, phantom.target("SC").position.expand(3, 3))
    assert not math.isnan(float(start.rotation.sum()))
