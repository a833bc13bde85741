"""An arm carries the probe: its kinematics are MuJoCo's, and what it cannot follow is refused."""

import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import check_env_specs

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.world import STEP_SECONDS
from racines_envs import ScanEnv
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.recordings import EpisodeRecorder, rerun
from racines_envs.robots.arm import Arm
from racines_envs.robots.following import SINGULAR, ArmRobot, make_robot
from racines_envs.robots.kinematics import Kinematics
from racines_envs.robots.ur5e import UR5E
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core

pytest.importorskip("pytorch_kinematics")
ROWS = 12


@pytest.fixture(scope="module")
def joints() -> torch.Tensor:
    chance = torch.Generator().manual_seed(0)
    return (2.0 * torch.rand(100, 6, generator=chance, dtype=torch.float64) - 1.0) * math.pi


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(UR5E)


def core_of(phantom, rows: int = ROWS, robot: str | Arm = "ur5e", **settings):
    given = {"observation": "params", "reward": "oracle", "phantom": phantom, "robot": robot}
    return make_core("SC", rows, **given, **settings)


def test_poses_and_jacobians_are_mujocos(kinematics, joints):
    mujoco = pytest.importorskip("mujoco")
    told = '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(UR5E.urdf().replace("</robot>", told))
    data = mujoco.MjData(model)
    tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "tip")
    pose, jacobian = kinematics._look(joints)
    for row, angles in enumerate(joints.numpy()):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        rotation = data.xmat[tip].reshape(3, 3)
        point = data.xpos[tip] + UR5E.tool * rotation[:, 2]
        moving, turning = np.zeros((3, 6)), np.zeros((3, 6))
        mujoco.mj_jac(model, data, moving, turning, point, tip)
        assert np.abs(point - pose.position[row].numpy()).max() < 1e-6
        assert np.abs(rotation - pose.rotation[row].numpy()).max() < 1e-6
        assert np.abs(np.vstack([moving, turning]) - jacobian[row].numpy()).max() < 1e-6


def test_joints_are_found_again_whoever_else_is_asked(kinematics, joints):
    near = joints[kinematics.reach(joints) > 0.05]
    pose = kinematics.forward(near)
    found, there = kinematics.solve(pose, near + 0.03, 4)
    assert bool(there.all()) and float((found - near).abs().max()) < 1e-6
    for rows in (1, 3, 17):
        some = Pose(*(part[:rows] for part in pose))
        assert torch.equal(kinematics.solve(some, near[:rows] + 0.03, 4)[0], found[:rows])


def test_every_start_is_in_reach_and_the_planner_finds_its_way(real_phantom):
    seeds = evaluation_seeds(40)
    core = core_of(real_phantom, 40)
    final = rollout(core, PlannerAgent(), seeds).final
    assert final["success"].mean() == 1.0
    state, kinematics = core.state, Kinematics(UR5E)
    at = kinematics.forward(state.joints)
    assert float((at.position - state.position).abs().max()) < 1e-5
    assert float((at.rotation - state.rotation).abs().max()) < 1e-5


def test_what_the_arm_cannot_follow_is_refused_and_counted(phantom):
    """Too slow for any step: nothing moves, and it is not the workspace's doing."""
    slow = replace(UR5E, name="slow", speeds=(1e-3,) * 6)
    core, free = core_of(phantom, robot=slow), core_of(phantom, robot="free")
    core.reset(0), free.reset(0)
    began = core.state.position.clone()
    action = torch.zeros(ROWS, dtype=torch.int64)
    core.step(action), free.step(action)
    moved = (free.state.position != began).any(1)
    assert bool(moved.any()) and torch.equal(core.state.position, began)
    assert torch.equal(core.state.arm_hits, moved.long())
    assert torch.equal(core.info()["arm_hits"], moved.long())
    assert "arm_hits" not in free.info() and free.state.joints.shape == (ROWS, 0)


def test_limits_and_singularities_hold():
    robot = ArmRobot(UR5E, "cpu")
    joints = torch.tensor([[2.94, -1.35, 2.11, -2.32, -math.pi / 2, 2 * math.pi - 0.01]]).double()
    turn = torch.zeros(1, 6, dtype=torch.float64)
    turn[0, 5] = 0.02
    pose = robot.kinematics.forward(joints + turn)
    assert not bool(robot.follow(joints, pose)[1])  # past the limit of the last joint
    assert bool(robot.follow(joints - 0.1, robot.kinematics.forward(joints - 0.1 + turn))[1])
    stretched = torch.tensor([[2.94, -1.35, 0.05, -2.32, -math.pi / 2, 0.0]]).double()
    bent = torch.tensor([[0.0, -0.01, 0.02, 0.0, 0.0, 0.0]])
    inwards, outwards = (robot.kinematics.forward(stretched + by) for by in (bent, -bent))
    assert float(robot.kinematics.reach(stretched)) < SINGULAR
    assert bool(robot.follow(stretched, inwards)[1])
    assert not bool(robot.follow(stretched, outwards)[1])


def test_speeds_hold():
    robot = ArmRobot(UR5E, "cpu")
    joints = torch.tensor([list(UR5E.home)], dtype=torch.float64)
    for share, allowed in ((0.9, True), (1.1, False)):
        later = joints.clone()
        later[0, 5] += share * UR5E.speeds[5] * STEP_SECONDS
        assert bool(robot.follow(joints, robot.kinematics.forward(later))[1]) is allowed


def test_every_interface_shows_the_joints(real_phantom):
    made = {"observation": "params", "reward": "oracle", "phantom": real_phantom, "robot": "ur5e"}
    env = gymnasium.make("racines_envs:racines/SC-v0", **made)
    check_env(env.unwrapped, skip_render_check=True)
    seen, _ = env.reset(seed=0)
    assert seen["joints"].shape == (6,) and np.abs(seen["joints"]).max() < 2 * math.pi
    check_env_specs(ScanEnv("SC", 2, **made))
    assert "joints" in ScanEnv("SC", 2, **made).reset()


def test_recordings_hold_the_joints_and_run_again(tmp_path):
    env = gymnasium.make(
        "racines_envs:racines/SC-v0", observation="params", reward="oracle", robot="ur5e"
    )
    recorder = EpisodeRecorder(env, tmp_path, video=False)
    recorder.reset(seed=0)
    for action in range(8):
        recorder.step(action)
    recorder.close()
    assert '"robot": "ur5e"' in recorder.written[0].read_text()
    assert rerun(recorder.written[0]).steps == 8


def test_unknown_and_wrong_arms_are_refused(phantom):
    with pytest.raises(RacinesError, match="unknown robot 'ur5'"):
        make_robot("ur5", "cpu")
    with pytest.raises(RacinesError, match="speeds has 5 entries: give one for each of 6 links"):
        replace(UR5E, speeds=(1.0,) * 5)
    far = Pose(torch.tensor([[2.0, 0.0, 0.1]]), torch.eye(3).unsqueeze(0))
    with pytest.raises(RacinesError, match="cannot take the start at"):
        ArmRobot(UR5E, "cpu").begin(far)
