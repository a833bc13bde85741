"""An EnvHub folder: `env.py` with the `make_env` that LeRobot asks for, and what it is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.store.sweeps import new_folder
from racines_envs.task.tasks import get_task

_ENV = '''"""RACINES, robotic cardiac ultrasound, for LeRobot. Needs the package `racines`."""

from racines_envs.apis.lerobot import make_env as make_racines

VIEWS = {views!r}


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return {{"racines": {{0: the first task, …}}}}."""
    return make_racines(n_envs, use_async_envs, cfg, views=VIEWS)
'''
_README = """---
tags: [LeRobot, ultrasound, robotics]
---
# RACINES, tasks for LeRobot

{tasks}. Find a standard view of a simulated heart with an ultrasound probe: pictures of 128×128
pixels (`observation.images.ultrasound`), pose and force (`observation.state`), commanded velocity
in the base frame (`action`), 0.1 s a step; success is judged by the phantom.

Needs `pip install racines`. Research software, not a medical device.
"""


def write_envhub(out: Path, views: Sequence[str]) -> dict[str, Any]:
    """Write `env.py`, `requirements.txt` and `README.md` of some tasks to a new folder.

    Raises:
        RacinesError: no task, an unknown one, or a folder that is there.
    """
    if not views:
        raise RacinesError("--view: name a task, e.g. SC")
    tasks = [get_task(view).name for view in views]
    with new_folder(out) as folder:
        (folder / "env.py").write_text(_ENV.format(views=tuple(tasks)))
        (folder / "requirements.txt").write_text("racines\n")
        (folder / "README.md").write_text(_README.format(tasks=", ".join(tasks)))
    return {"out": str(out), "tasks": tasks}
