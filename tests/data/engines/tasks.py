"""Work for engines: functions of a module, as workers find them."""

import os
import signal
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_envs.agents.random import RandomAgent
from tests.data.fake_source import FakeSource


def told(state: Any, task: int) -> dict[str, Any]:
    """Return where and how a task runs."""
    return {
        "task": task, "state": state, "process": os.getpid(), "folder": os.getcwd(),
        "threads": torch.get_num_threads(),
    }  # fmt: skip


def refuses(state: str, task: int) -> int:
    if task == 3:
        raise RacinesError(f"{state}: three is refused")
    return task


def die_once(folder: Path, name: str) -> None:
    """Kill this process the first time that it is asked to, and leave a mark."""
    mark = folder / f"{name}.died"
    if not mark.exists():
        mark.write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)


def dies_once(folder: Path, task: int) -> int:
    """Leave a mark of each time that a task is done; one of them kills its worker first."""
    if task == 2:
        die_once(folder, "two")
    with (folder / f"{task}.done").open("a") as file:
        file.write("done\n")
    return task * task


def dies_always(state: None, task: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return task


class DyingSource(FakeSource):
    """Kills its worker once, in the middle of the build."""

    def produce(self, unit):
        if unit.id == "t007":
            die_once(Path(self.config.journal), "t007")
        return super().produce(unit)


class DyingAgent(RandomAgent):
    """Draws its actions, and kills its worker once in the middle of a start set."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder, self.decisions = folder, 0

    def act(self, observation, seeds):
        self.decisions += 1
        if self.decisions == 10:
            die_once(self.folder, "agent")
        return super().act(observation, seeds)
