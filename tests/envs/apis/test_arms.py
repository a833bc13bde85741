"""An arm behind every interface: the package's own, and one that is a file of somebody else's."""

import ast
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import check_env_specs
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs import ScanEnv
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.apis.lerobot import LeRobotEnv
from racines_envs.apis.lerobot.formats import FORMATS, features_of
from racines_envs.apis.sb3 import SB3ScanEnv
from racines_envs.robots.ur5e import UR5E
from racines_envs.task.names import REPLAY_ID
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_leaderboard.cli.command import app

pytest.importorskip("pytorch_kinematics")
ID = "racines/PL-v0"
PANDA = "tests.envs.panda:PANDA"
ARMS = {"ur5e": 6, PANDA: 7}
REMOTE = replace(UR5E, name="remote", tool=3.0)
"""An arm with a probe so long that no frame of a dataset is in its reach."""
ROWS, STEPS = 2, 3


def single(**given: Any) -> list[Any]:
    env = gymnasium.make(f"racines_envs:{ID}", **given)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    return [env.step(action)[0]["joints"][None] for action in range(STEPS)]


def many(**given: Any) -> list[Any]:
    envs = gymnasium.make_vec(f"racines_envs:{ID}", num_envs=ROWS, **given)
    envs.reset(seed=0)
    return [envs.step(np.full(ROWS, action))[0]["joints"] for action in range(STEPS)]


def torchrl(**given: Any) -> list[Any]:
    env = ScanEnv("PL", ROWS, **given)
    check_env_specs(env)
    env.set_seed(0)
    data, seen = env.reset(), []
    for action in range(STEPS):
        data = env.step(data.set("action", torch.full((ROWS,), action)))["next"]
        seen.append(data["joints"].numpy())
    return seen


def sb3(**given: Any) -> list[Any]:
    envs: Any = SB3ScanEnv(ID, ROWS, **given)
    envs.seed(0)
    envs.reset()
    return [envs.step(np.full(ROWS, action))[0]["joints"] for action in range(STEPS)]


def tianshou(**given: Any) -> list[Any]:
    from racines_envs.apis.tianshou import TianshouScanEnv

    envs = TianshouScanEnv(ID, ROWS, **given)
    envs.seed(0)
    seen = (envs.step(np.full(ROWS, action))[0] for action in range(STEPS))
    return [np.stack([row["joints"] for row in rows]) for rows in seen]


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let our side of Tianshou's interface load where the library itself is not installed."""

    class BaseVectorEnv:
        env_num: int

        def _wrap_id(self, rows: Any = None) -> list[int]:
            return list(range(self.env_num)) if rows is None else list(rows)

    module: Any = ModuleType("tianshou.env")
    module.BaseVectorEnv = BaseVectorEnv
    monkeypatch.setitem(sys.modules, "tianshou", ModuleType("tianshou"))
    monkeypatch.setitem(sys.modules, "tianshou.env", module)
    ours = "racines_envs.apis.tianshou"
    before = sys.modules.pop(ours, None)
    yield
    sys.modules.pop(ours, None)
    if before is not None:
        sys.modules[ours] = before


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize("interface", [single, many, torchrl, sb3, tianshou])
@pytest.mark.parametrize("robot", ARMS)
def test_every_interface_shows_the_joints_that_follow_the_steps(real_phantom, interface, robot):
    given = {"observation": "params", "reward": "oracle", "phantom": real_phantom, "robot": robot}
    core = make_core("PL", ROWS, **given)
    before = core.reset(0)["joints"]
    wanted = [core.step(torch.full((ROWS,), action)).observation for action in range(STEPS)]
    assert before.shape == (ROWS, ARMS[robot]) and not torch.equal(before, wanted[-1]["joints"])
    for found, expected in zip(interface(**given), wanted, strict=True):
        assert np.array_equal(found, expected["joints"].numpy()[: len(found)])


def test_an_arm_of_seven_joints_finds_its_way(real_phantom):
    core = make_core("PL", 12, observation="params", phantom=real_phantom, robot=PANDA,
                     reward="oracle")  # fmt: skip
    final = rollout(core, PlannerAgent(), evaluation_seeds(12)).final
    assert final["success"].all() and "arm_hits" in final
    carrier: Any = core.robot
    at = carrier.kinematics.forward(core.state.joints)
    assert float((at.position - core.state.position).abs().max()) < 1e-5


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("robot", ARMS)
def test_lerobot_is_shown_the_joints_and_the_folder_tells_of_them(
    phantom, tmp_path: Path, name: str, robot: str
):
    env = LeRobotEnv("PL", name, phantom=phantom, robot=robot)
    seen, _ = env.reset(seed=1)
    assert env.observation_space.contains(seen)
    core = make_core("PL", phantom=phantom, robot=robot, observation="params", action="velocity")
    assert np.array_equal(seen["joints"], core.reset(1)["joints"][0].numpy())
    seen, *_, info = env.step(np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.1], np.float32))
    assert seen["joints"].shape == (ARMS[robot],) and info["arm_hits"] == 0
    words = ["export", "envhub", "PL", "--format", name, "--set", f"robot={robot}"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "hub")], catch_exceptions=False)
    assert done.exit_code == 0
    plugin, made = (
        {
            node.targets[0].id: ast.literal_eval(node.value)
            for node in ast.parse((tmp_path / "hub" / file).read_text()).body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        }
        for file in ("lerobot_env_racines/__init__.py", "env.py")
    )
    assert made["ROBOT"] == robot and plugin["FEATURES"] == features_of(name, robot)
    assert plugin["FEATURES"]["joints"] == ("STATE", (ARMS[robot],))
    assert plugin["NAMES"]["joints"] == "observation.joints"


def test_what_is_no_setting_of_a_folder_is_refused(tmp_path: Path):
    words = ["export", "envhub", "PL", "--set", "speed=2", "--out", str(tmp_path / "hub")]
    refused = CliRunner().invoke(app, words)
    assert "envhub.speed: unknown key; known: robot" in str(refused.exception)


def test_an_arm_carries_the_probe_in_recordings_within_its_reach(tiny_root: Path):
    given: dict[str, Any] = {"data": tiny_root, "view": "PL", "observation": "params"}
    env = gymnasium.make(f"racines_envs:{REPLAY_ID}", robot="ur5e", **given)
    seen, _ = env.reset(seed=0)
    told, *_, info = env.step(0)
    assert seen["joints"].shape == (6,) and info["arm_hits"] == 0
    assert info["workspace_hits"] == 1 or not np.array_equal(told["joints"], seen["joints"])
    with pytest.raises(RacinesError, match="'remote' cannot take the start at"):
        gymnasium.make(f"racines_envs:{REPLAY_ID}", robot=f"{__name__}:REMOTE", **given).reset()
    with pytest.raises(RacinesError, match="'mask' knows no arm's joints: use beyond='refuse'"):
        gymnasium.make(f"racines_envs:{REPLAY_ID}", robot="ur5e", beyond="mask", **given)
