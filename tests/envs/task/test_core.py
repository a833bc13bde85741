"""The batched core: rows are independent, limits hold, episodes end and start again."""

import dataclasses

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, parameters_to_pose
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import RewardConfig
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core
from racines_models.protocol import Judge
from tests.variants import crossed

STEPS = 60


def core_of(phantom, count=1, observation="params", reward="oracle", **more) -> ScanCore:
    return make_core(
        more.pop("task", "SC"),
        count,
        observation=observation,
        reward=reward,
        phantom=phantom,
        **more,
    )


def actions(count: int, steps: int = STEPS) -> torch.Tensor:
    return torch.randint(0, 13, (steps, count), generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("reward", "observation"),
    crossed(["oracle", "paper", "shaped"], ["params", "image", "multimodal"]),
)
def test_a_batch_equals_single_environments_step_by_step(phantom, grader, observation, reward):
    task = dataclasses.replace(get_task("SC"), max_steps=17)  # several episodes
    more = {"task": task, "observation": observation, "reward": reward, "grader": grader}
    together = core_of(phantom, 4, **more)
    alone = [core_of(phantom, 1, **more) for _ in range(4)]
    first = together.reset(seed=5)
    for row, core in enumerate(alone):
        seen = core.reset(seed=5 + row)
        assert all(torch.equal(seen[k][0], first[k][row]) for k in first)
    for action in actions(4):
        batch = together.step(action, autoreset=True)
        info = together.info()
        for row, core in enumerate(alone):
            single = core.step(action[row : row + 1], autoreset=True)
            for key, value in single.observation.items():
                assert torch.equal(value[0], batch.observation[key][row])
            for ours, theirs in zip(single[1:], batch[1:], strict=True):
                assert torch.equal(ours[0], theirs[row])
            for key, value in core.info().items():
                if key == "probability":
                    # The last bit of torch's sigmoid depends on an element's place in a vector.
                    assert torch.allclose(value[0], info[key][row], rtol=2.5e-7, atol=0.0)
                else:
                    assert torch.equal(value[0], info[key][row]), key


def test_the_same_seed_gives_the_same_episode_and_another_another(phantom):
    core = core_of(phantom, 3, "multimodal")
    a, b, c = core.reset(seed=1), core.reset(seed=1), core.reset(seed=2)
    assert all(torch.equal(a[k], b[k]) for k in a)
    assert torch.equal(a["params"][1:], c["params"][:2])  # row i of seed s is seed s + i
    assert not torch.equal(a["params"], c["params"])


def test_the_next_episode_of_a_seed_differs_and_repeats(phantom):
    core = core_of(phantom, 2)
    first, second = core.reset(seed=1)["params"], core.reset()["params"]
    assert not torch.equal(first, second)
    core.reset(seed=1)
    assert torch.equal(core.reset()["params"], second)


def test_noise_is_new_in_every_episode_and_at_every_step(phantom):
    core, still = core_of(phantom, 2, "multimodal"), phantom.target("SC")
    pose = Pose(still.position.expand(2, 3), still.rotation.expand(2, 3, 3))
    seen = [core.reset(seed=1, pose=pose), core.reset(pose=pose), core.reset(pose=pose)]
    seen += [core.step(torch.full((2,), IDLE)).observation for _ in range(2)]
    assert all(torch.equal(each["params"], seen[0]["params"]) for each in seen)
    images = torch.cat([each["image"] for each in seen]).flatten(1)
    assert len(images.unique(dim=0)) == 10


def test_an_agents_draws_are_new_in_every_episode_and_at_every_step(phantom):
    core = core_of(phantom, 2)
    core.reset(seed=1)
    drawn = [core.decision_seeds()]
    for _ in range(2):
        core.step(torch.full((2,), IDLE))
        drawn.append(core.decision_seeds())
    core.reset()
    assert len(torch.cat([*drawn, core.decision_seeds()]).unique()) == 8


def test_only_masked_rows_start_again(phantom):
    core = core_of(phantom, 4, "multimodal")
    core.reset(seed=0)
    for action in actions(4, 5):
        before = core.step(action).observation
    mask = torch.tensor([False, True, False, True])
    phantom.rendered = 0
    after = core.reset(mask=mask)
    assert phantom.rendered == 2
    assert torch.equal(after["image"][~mask], before["image"][~mask])
    assert core.state.steps.tolist() == [5, 0, 5, 0]
    assert not torch.equal(after["params"][mask], before["params"][mask])


def test_params_with_the_oracles_reward_draw_nothing(phantom):
    core = core_of(phantom, 3)
    core.reset(seed=0)
    core.step(torch.full((3,), IDLE))
    assert phantom.rendered == 0
    assert core.picture().shape == (3, 128, 128) and phantom.rendered == 3


def test_parameters_are_the_pose_and_the_contacts_wrench(phantom):
    core = core_of(phantom, 3)
    core.reset(seed=0)
    core.step(torch.tensor([0, 7, 4]))
    pose = parameters_to_pose(core.parameters)
    assert torch.allclose(pose.position, core.state.position)
    assert torch.allclose(pose.rotation, core.state.rotation, atol=1e-5)
    assert torch.equal(core.parameters[:, :6], phantom.wrench(core.state.pose))


def test_params_are_scaled_to_the_workspace(phantom):
    core = core_of(phantom)
    corner = Pose(phantom.workspace.position_max[None], phantom.target("SC").rotation)
    seen = core.reset(seed=0, pose=corner)["params"]
    assert torch.allclose(seen[0, :3], torch.ones(3), atol=1e-5)
    assert torch.allclose(seen[0, 3:6], corner.rotation[0, :, 0], atol=1e-6)


# -- limits ----------------------------------------------------------------------------------------


def test_a_step_out_of_the_workspace_becomes_idle_and_is_counted(phantom):
    core = core_of(phantom)
    high = phantom.target("SC").position.clone()
    high[:, 2] = 0.1339
    core.reset(seed=0, pose=Pose(high, phantom.target("SC").rotation))
    up = torch.tensor([ACTIONS.index("-z")])  # back along the beam, so up
    core.step(up)
    assert torch.equal(core.state.position, high)
    assert core.info()["workspace_hits"].item() == 1
    assert core.info()["force_hits"].item() == 0
    core.step(torch.tensor([ACTIONS.index("+z")]))
    assert core.state.position[0, 2] < 0.1339
    assert core.info()["workspace_hits"].item() == 1


def test_a_step_over_the_force_limit_becomes_idle_and_is_counted(phantom):
    core = core_of(phantom, termination="timeout")
    core.reset(seed=0, pose=phantom.target("SC"))  # 6 mm deep: 12 N
    press, forces = torch.tensor([ACTIONS.index("+z")]), []
    for _ in range(4):
        core.step(press)
        forces.append(core.info()["force"].item())
    assert max(forces) <= core.task.force_limit
    assert core.info()["force_hits"].item() >= 2
    assert core.info()["peak_force"].item() == pytest.approx(max(forces))
    core.step(torch.tensor([ACTIONS.index("-z")]))
    assert core.info()["force"].item() < forces[-1]


def test_a_probe_that_starts_over_the_limit_may_ease_off(phantom):
    core = core_of(phantom)
    deep = phantom.target("SC").position.clone()
    deep[:, 2] = 0.05  # 30 N
    core.reset(seed=0, pose=Pose(deep, phantom.target("SC").rotation))
    core.step(torch.tensor([ACTIONS.index("-z")]))
    assert core.state.position[0, 2] > 0.05
    assert core.info()["force_hits"].item() == 0


# -- ends ------------------------------------------------------------------------------------------


def idle_at_the_target(phantom, termination: str, steps: int) -> list[tuple[bool, bool, float]]:
    core = core_of(phantom, termination=termination)
    core.reset(seed=0, pose=phantom.target("SC"))
    log = []
    for _ in range(steps):
        _, reward, ended, cut = core.step(torch.tensor([IDLE]))
        log.append((bool(ended), bool(cut), float(reward)))
    return log


def test_terminations(phantom):
    assert [e for e, _, _ in idle_at_the_target(phantom, "first_hit", 1)] == [True]
    assert [e for e, _, _ in idle_at_the_target(phantom, "k_hits", 3)] == [False, False, True]
    ends = idle_at_the_target(phantom, "timeout", 200)
    assert not any(e for e, _, _ in ends)
    assert [cut for _, cut, _ in ends] == [False] * 199 + [True]


def test_forces_are_told_at_their_peak_and_on_average(phantom):
    core = core_of(phantom)
    core.reset(seed=0, pose=phantom.target("SC"))  # 12 N
    forces = []
    for name in ("-z", "-z", "+z"):
        core.step(torch.tensor([ACTIONS.index(name)]))
        told = core.info(view_error=False)
        forces.append(told["force"].item())
        assert told["mean_force"].item() == pytest.approx(sum(forces) / len(forces))
        assert told["peak_force"].item() == pytest.approx(12.0, rel=1e-4)
        assert "view_position_error" not in told and "view_position_error" in core.info()


def test_hits_must_be_in_a_row(phantom):
    core = core_of(phantom, task=dataclasses.replace(get_task("SC"), step_translation=0.02))
    core.reset(seed=0, pose=phantom.target("SC"))
    idle, away, back = (torch.tensor([ACTIONS.index(name)]) for name in ("idle", "+x", "-x"))
    streaks = []
    for action in (idle, idle, away, back, idle, idle):
        core.step(action)
        streaks.append(core.state.streak.item())
    assert streaks == [1, 2, 0, 1, 2, 3] and bool(core.state.done)


def test_a_row_that_has_ended_stays_until_it_is_reset(phantom):
    log = idle_at_the_target(phantom, "k_hits", 6)
    assert [e for e, _, _ in log] == [False, False, True, False, False, False]
    assert all(reward > 49 for _, _, reward in log[:3])
    assert [reward for _, _, reward in log[3:]] == [0, 0, 0]


def test_autoreset_ignores_one_action_and_pays_nothing_for_it(phantom):
    core = core_of(phantom, task=dataclasses.replace(get_task("SC"), max_steps=3))
    core.reset(seed=0)
    cuts, steps = [], []
    for _ in range(8):
        out = core.step(torch.tensor([0]), autoreset=True)
        cuts.append(bool(out.truncated))
        steps.append(core.state.steps.item())
        if core.state.steps.item() == 0:
            assert out.reward.item() == 0
    assert steps == [1, 2, 3, 0, 1, 2, 3, 0]
    assert cuts == [False, False, True, False, False, False, True, False]


def test_the_return_is_the_sum_of_rewards(phantom):
    core = core_of(phantom, 5)
    core.reset(seed=3)
    total = sum(core.step(a).reward for a in actions(5, 30))
    assert torch.allclose(core.info()["return"], total, atol=1e-4)


def test_rewards_come_from_the_grader_or_from_the_truth(phantom, grader):
    paper = core_of(phantom, 4, reward="paper", grader=grader)
    oracle = core_of(phantom, 4)
    paper.reset(seed=0)
    oracle.reset(seed=0)
    p, g = grader.probabilities_and_grade(paper.picture())
    assert torch.equal(paper.score.probability, p[:, paper.task.target])
    assert torch.equal(paper.score.grade, g)
    truth = phantom.judge(oracle.state.pose)
    assert torch.equal(oracle.score.probability, truth.membership[:, 1])
    assert torch.equal(oracle.score.grade, truth.view_grade[:, 1])


def test_a_hit_by_the_grader_is_no_success_by_truth(phantom):
    class Believer(Judge):
        def probabilities_and_grade(self, images):
            return torch.ones(len(images), 6), torch.full((len(images),), 9.0)

    core = core_of(phantom, 2, reward="paper", grader=Believer(), termination="first_hit")
    core.reset(seed=0)
    out = core.step(torch.tensor([IDLE, IDLE]))
    assert bool(out.terminated.all())
    assert not bool(core.info()["success"].any())


def test_success_needs_the_true_view_and_grade_is_told_apart(phantom):
    core = core_of(phantom, rewards=RewardConfig(grade=9.9))
    core.reset(seed=0, pose=phantom.target("SC"))
    assert core.info()["success"].item() and core.info()["success_graded"].item()
    assert core.info()["position_error"].item() == 0
    for name in ("+x", "+x"):
        core.step(torch.tensor([ACTIONS.index(name)]))
    info = core.info()
    assert info["success"].item() and not info["success_graded"].item()
    assert info["position_error"].item() == pytest.approx(0.006, rel=1e-3)


def test_the_distance_is_in_unit_steps_and_counts_the_rotation(phantom):
    core, goal = core_of(phantom, reward="shaped"), phantom.target("SC")
    metres, radians = 3 * core.task.step_translation, 2 * core.task.step_rotation
    turn = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, radians]]))
    core.reset(seed=0, pose=Pose(goal.position + torch.tensor([metres, 0, 0]), goal.rotation))
    assert core.score.distance.item() == pytest.approx(3.0, rel=1e-3)
    core.reset(seed=0, pose=Pose(goal.position, goal.rotation @ turn))
    assert core.score.distance.item() == pytest.approx(2.0, rel=1e-3)


# -- bad input -------------------------------------------------------------------------------------


def test_bad_input_is_refused_with_a_reason(phantom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("racines_models.published.places.CHECKOUT", tmp_path)
    with pytest.raises(RacinesError, match=r"racines train grader.*reward='oracle'"):
        core_of(phantom, reward="paper")
    with pytest.raises(RacinesError, match="observation"):
        core_of(phantom, observation="video")
    with pytest.raises(RacinesError, match="backend"):
        core_of(phantom, backend="replayer")
    with pytest.raises(RacinesError, match="unknown view"):
        core_of(phantom, task="A5C")
    with pytest.raises(RacinesError, match="num_envs"):
        core_of(phantom, 0)
    with pytest.raises(RacinesError, match="generator"):
        core_of(phantom, backend="generator")
    with pytest.raises(RacinesError, match=r"unknown generator 'nothing': choose one of"):
        core_of(phantom, backend="generator", generator="nothing")
    with pytest.raises(RacinesError, match="reset"):
        core_of(phantom).step(torch.tensor([0]))


def test_start_poses_outside_the_workspace_or_not_finite_are_refused(phantom):
    core = core_of(phantom)
    rotation = phantom.target("SC").rotation
    with pytest.raises(RacinesError, match="outside the workspace"):
        core.reset(pose=Pose(torch.tensor([[0.7, 0.0, 0.06]]), rotation))
    with pytest.raises(RacinesError, match="not finite"):
        core.reset(pose=Pose(torch.tensor([[float("nan"), 0.0, 0.06]]), rotation))
    with pytest.raises(RacinesError, match="shape"):
        core.reset(pose=Pose(torch.zeros(2, 3), rotation.expand(2, 3, 3)))


def test_any_image_source_is_a_backend(phantom):
    class Gray:
        def generate(self, parameters, seed):
            assert parameters.shape[1] == 12
            return torch.full((len(parameters), 128, 128), 77, dtype=torch.uint8)

    for settings in ({"backend": Gray()}, {"backend": "generator", "generator": Gray()}):
        seen = core_of(phantom, 2, "image", **settings).reset(seed=0)
        assert bool((seen["image"] == 77).all()) and phantom.rendered == 0


def test_rows_that_are_not_chosen_stay_as_they_are_and_may_have_ended(phantom):
    task = dataclasses.replace(get_task("SC"), max_steps=5)
    core, alone = core_of(phantom, 3, task=task), core_of(phantom, 1, task=task)
    core.reset(seed=0)
    alone.reset(seed=1)
    for action in actions(3, 5):
        before = core.state
        given = core.step(action, rows=torch.tensor([1]), strict=True)
        own = alone.step(action[1:2])
        assert torch.equal(given.observation["params"][1:2], own.observation["params"])
        assert torch.equal(given.reward[[0, 2]], torch.zeros(2)) and given.reward[1] == own.reward
        for part in dataclasses.fields(before):
            was, now = (getattr(state, part.name)[[0, 2]] for state in (before, core.state))
            assert torch.equal(was, now), part.name
    assert core.state.done.tolist() == [False, True, False]
    core.step(torch.tensor([1, 1, 1]), rows=torch.tensor([0, 2]), strict=True)
    assert core.state.steps.tolist() == [1, 5, 1]
    with pytest.raises(RacinesError, match="episode of row 1 has ended"):
        core.step(torch.tensor([1, 1, 1]), rows=torch.tensor([1, 2]), strict=True)
    core.step(torch.tensor([1, 1, 1]), autoreset=True, rows=torch.tensor([0]))
    assert core.state.steps.tolist() == [2, 5, 1], "who is not chosen is not reset"
