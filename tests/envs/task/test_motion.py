"""Velocities: the thirteen steps are special cases, limits hold, and hands that rest declare."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import check_env_specs

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, geodesic
from racines_envs import ScanEnv
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.recordings import EpisodeRecorder, rerun
from racines_envs.task.motion import IDLES_BELOW, make_motion
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core

ROWS = 16
SC = get_task("SC")


@pytest.fixture
def velocity():
    return make_motion("velocity", SC, "cpu")


def core_of(phantom, action: str):
    return make_core(
        "SC", ROWS, observation="params", reward="oracle", phantom=phantom, action=action
    )


def test_steps_are_twists_bit_for_bit(phantom):
    steps, twists = core_of(phantom, "discrete"), core_of(phantom, "velocity")
    steps.reset(3), twists.reset(3)
    chance = torch.Generator().manual_seed(0)
    for _ in range(40):
        action = torch.randint(13, (ROWS,), generator=chance)
        given = steps.step(action, autoreset=True)
        same = twists.step(twists.motion.check(action, ROWS), autoreset=True)
        for name in ("position", "rotation", "idle", "steps", "workspace_hits", "force_hits"):
            assert torch.equal(getattr(steps.state, name), getattr(twists.state, name)), name
        assert torch.equal(given.reward, same.reward)


def test_agents_that_choose_steps_act_among_twists(phantom):
    seeds = evaluation_seeds(ROWS)
    ends = [rollout(core_of(phantom, action), PlannerAgent(), seeds).final
            for action in ("discrete", "velocity")]  # fmt: skip
    assert all(np.array_equal(ends[0][key], ends[1][key]) for key in ends[0])


def test_a_twist_shifts_along_the_probes_axes_and_turns_about_its_own(velocity):
    turned = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, torch.pi / 2]]))
    twist = torch.tensor([[0.02, 0.0, 0.0, 0.3, 0.4, 0.0]])
    moved = velocity.move(Pose(torch.zeros(1, 3), turned), velocity.check(twist, 1))
    assert torch.allclose(moved.position, torch.tensor([[0.0, 0.002, 0.0]]), atol=1e-7)
    assert float(geodesic(moved.rotation, turned)) == pytest.approx(0.05, abs=1e-5)


def test_a_row_moves_as_it_does_alone(velocity):
    chance = torch.Generator().manual_seed(1)
    share = 2.0 * torch.rand(ROWS, 6, generator=chance) - 1.0
    twist, pose = (
        share * velocity.limits,
        Pose(torch.rand(ROWS, 3), torch.eye(3).expand(ROWS, 3, 3)),
    )
    together = velocity.move(pose, twist)
    for row in range(ROWS):
        alone = velocity.move(Pose(*(part[row : row + 1] for part in pose)), twist[row : row + 1])
        assert all(torch.equal(a[0], b[row]) for a, b in zip(alone, together, strict=True))


def test_hands_that_rest_are_idle(velocity):
    rest = 0.99 * IDLES_BELOW * velocity.limits.expand(2, 6).clone()
    rest[1, 4] = 1.01 * IDLES_BELOW * velocity.limits[4]
    assert velocity.idles(rest).tolist() == [True, False]
    pose = Pose(torch.zeros(2, 3), torch.eye(3).expand(2, 3, 3))
    moved = velocity.move(pose, rest)
    assert torch.equal(moved.position[0], pose.position[0])
    assert not torch.equal(moved.position[1], pose.position[1])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            torch.full((ROWS, 6), torch.nan),
            "has to be finite, at most 0.03 m/s along and 0.6 rad/s",
        ),
        (torch.full((ROWS, 6), 0.031), "at most 0.03 m/s"),
        (torch.zeros(ROWS, 5), r"give \(16, 6\) floats"),
        (torch.zeros(ROWS, 6, dtype=torch.int64), r"give \(16, 6\) floats"),
        (torch.full((ROWS,), 13), "action 13 is out of range"),
    ],
)
def test_wrong_twists_are_refused(phantom, action, message):
    core = core_of(phantom, "velocity")
    core.reset(0)
    with pytest.raises(RacinesError, match=message):
        core.step(action)


def test_an_unknown_kind_of_action_is_refused(phantom):
    with pytest.raises(RacinesError, match="unknown action 'torque': choose one of discrete, vel"):
        core_of(phantom, "torque")


def test_every_interface_takes_twists(phantom):
    settings = {"observation": "params", "reward": "oracle", "phantom": phantom}
    made = {"action": "velocity", **settings}
    env = gymnasium.make("racines_envs:racines/SC-v0", **made)
    limits = np.array([0.03] * 3 + [0.6] * 3, np.float32)
    assert np.allclose(env.action_space.high, limits) and np.allclose(env.action_space.low, -limits)
    check_env(env.unwrapped, skip_render_check=True)
    check_env_specs(ScanEnv("SC", 3, **made))
    rows = gymnasium.make_vec("racines_envs:racines/SC-v0", num_envs=3, **made)
    alone = [gymnasium.make("racines_envs:racines/SC-v0", **made) for _ in range(3)]
    rows.reset(seed=5)
    for row, one in enumerate(alone):
        one.reset(seed=5 + row)
    rows.action_space.seed(0)
    for _ in range(5):
        twists = rows.action_space.sample()
        seen = rows.step(twists)[0]
        for row, one in enumerate(alone):
            assert np.array_equal(seen[row], one.step(twists[row])[0])
    with pytest.raises(RacinesError, match="twists of six numbers"):
        rows.step(np.array(["left"] * 3))


@pytest.mark.parametrize("still", [[0] * 6, np.zeros(6, int), np.zeros(6)])
def test_a_twist_of_whole_numbers_is_one(real_phantom, still):
    env = gymnasium.make(
        "racines_envs:racines/SC-v0", observation="params", reward="oracle", action="velocity"
    )
    seen = env.reset(seed=0)[0]
    assert np.allclose(env.step(still)[0][6:], seen[6:], atol=1e-3)


def test_recorded_twists_are_taken_again(real_phantom, tmp_path):
    env = gymnasium.make(
        "racines_envs:racines/SC-v0", observation="params", reward="oracle", action="velocity"
    )
    recorder = EpisodeRecorder(env, tmp_path, video=False)
    recorder.reset(seed=0)
    recorder.action_space.seed(0)
    for _ in range(12):
        recorder.step(recorder.action_space.sample())
    recorder.close()
    assert rerun(recorder.written[0]).steps == 12
    text = recorder.written[0].read_text()
    recorder.written[0].write_text(text.replace('"action": [', '"action": [1,', 1))
    with pytest.raises(RacinesError, match="line 3: unknown action"):
        rerun(recorder.written[0])
