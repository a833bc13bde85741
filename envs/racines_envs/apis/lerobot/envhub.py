"""An EnvHub folder: `env.py` with the `make_env` that LeRobot asks for, and what goes with it.

Beside it stand `lerobot_env_racines`, which makes the folder's tasks an environment type of
`lerobot-eval`, `to_onnx.py`, by which a checkpoint of LeRobot becomes a policy of the agents'
board, and what a repository of the Hub wants, `requirements.txt` and `README.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.store.sweeps import new_folder
from racines_envs.apis.lerobot import to_onnx
from racines_envs.apis.lerobot.formats import JOINTS, RECORDED, check_format, features_of
from racines_envs.robots.arm import FREE
from racines_envs.task.tasks import get_task

PLUGIN = "lerobot_env_racines"
_ENV = '''"""RACINES, robotic cardiac ultrasound, for LeRobot. Needs the package `racines`."""

from racines_envs.apis.lerobot import make_env as make_racines

VIEWS = {views!r}
FORMAT = {format!r}
ROBOT = {robot!r}


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return {{"racines": {{0: the first task, …}}}}."""
    return make_racines(n_envs, use_async_envs, cfg, views=VIEWS, format=FORMAT, robot=ROBOT)
'''
_PLUGIN = '''"""Tells LeRobot of the environment type `racines`: the tasks of the folder's `env.py`.

    lerobot-eval --env.discover_packages_path=lerobot_env_racines --env.type=racines …
"""

import importlib.util
from dataclasses import dataclass, field
from pathlib import Path

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig, HubEnvConfig

FEATURES = {features!r}
NAMES = {names!r}


@EnvConfig.register_subclass("racines")
@dataclass
class RacinesEnv(HubEnvConfig):
    """The tasks beside this package, or with `hub_path` those of a repository of the Hub."""

    fps: int = 10
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {{
            key: PolicyFeature(type=FeatureType[kind], shape=shape)
            for key, (kind, shape) in FEATURES.items()
        }}
    )
    features_map: dict[str, str] = field(default_factory=lambda: dict(NAMES))

    def create_envs(self, n_envs, use_async_envs=False):
        """Make the tasks of `env.py`."""
        path = Path(__file__).parents[1] / "env.py"
        spec = importlib.util.spec_from_file_location("racines_hub_env", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.make_env(n_envs, use_async_envs and n_envs > 1, self)
'''
_README = """---
tags: [LeRobot, ultrasound, robotics]
---
# RACINES, tasks for LeRobot

{tasks}. Find a standard view of a simulated heart with an ultrasound probe: pictures of 128×128
pixels (`observation.images.ultrasound`), {told}, 0.1 s a step; success is judged by the phantom.
They fit policies trained on `racines data export --format {format}`.{arm}

From this folder, in LeRobot's environment:

    PYTHONPATH=. lerobot-eval --env.discover_packages_path={plugin} --env.type=racines \\
        --policy.path=CHECKPOINT --policy.device=cpu --eval.n_episodes=20
    python to_onnx.py CHECKPOINT policy.onnx

Needs the package `{needs}`. Research software, not a medical device.
"""
_TOLD = {
    True: "pose and force (`observation.state`), commanded velocity in the base frame (`action`)",
    False: "pose (`observation.state`), twist in the probe's frame (`action`)",
}
_ARM = """
A {robot} carries the probe: its joints, rad, are `observation.joints`, and steps that they cannot
follow are refused. Exports of sweeps for the same arm have them too."""


@dataclass(frozen=True)
class HubConfig:
    """What else is settled of a folder's tasks."""

    robot: str = FREE
    """`free`, or the arm that carries the probe: `ur5e`, another's name, `module:ARM`."""


def write_envhub(
    out: Path, views: Sequence[str], format: str = RECORDED, robot: str = FREE
) -> dict[str, Any]:
    """Write some tasks to a new folder, with states and actions of a format (`formats`).

    Where a `robot` carries the probe, observations have its joints.

    Raises:
        RacinesError: no task, an unknown one, or format, or arm, or a folder that is there.
    """
    if not views:
        raise RacinesError("--view: name a task, e.g. SC")
    tasks = [get_task(view).name for view in views]
    features = features_of(check_format(format), robot)
    names = {
        "action": "action",
        "agent_pos": "observation.state",
        **({JOINTS: f"observation.{JOINTS}"} if JOINTS in features else {}),
        **{key: key.replace("pixels/", "observation.images.") for key in features if "/" in key},
    }
    told = {"tasks": ", ".join(tasks), "told": _TOLD[format == RECORDED]}
    told |= {"arm": "", "needs": "racines"}
    if robot != FREE:
        told |= {"arm": _ARM.format(robot=robot), "needs": "racines[robot]"}
    with new_folder(out) as folder:
        (folder / "env.py").write_text(
            _ENV.format(views=tuple(tasks), format=format, robot=robot), encoding="utf-8"
        )
        (folder / PLUGIN).mkdir()
        plugin = _PLUGIN.format(features=features, names=names)
        (folder / PLUGIN / "__init__.py").write_text(plugin, encoding="utf-8")
        (folder / "to_onnx.py").write_text(
            Path(to_onnx.__file__).read_text(encoding="utf-8"), encoding="utf-8"
        )
        (folder / "requirements.txt").write_text(f"{told['needs']}\n", encoding="utf-8")
        (folder / "README.md").write_text(
            _README.format(**told, format=format, plugin=PLUGIN), encoding="utf-8"
        )
    return {"out": str(out), "tasks": tasks, "format": format, "robot": robot}
