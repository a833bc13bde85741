"""The grid of agents on patients: each trained, then judged on five views, still and beating.

By the commands that users have and the settings of the profile `reference`; what is there already
is not made again, so that a grid that ran out of time goes on.
"""

import json
import time
from pathlib import Path
from typing import Any

from racines_data.views import VIEWS
from racines_envs.task.names import BEATING, PATIENTS
from tests.benchmarks.gpu.sizes import Sizes
from tests.benchmarks.gpu.training import run

TIERS = (PATIENTS, BEATING)


def grid(name: str, device: str, sizes: Sizes, work: Path, left: float) -> tuple[bool, dict]:
    """Train an agent and judge it on all tasks for so many seconds; return whether it is done."""
    end, folder = time.monotonic() + left, work / f"grid-{name}"
    about = ["--profile", "reference", "--device", device]
    trained = work / f"grid-{name}.trained"  # all its trainings: the first one's files do not tell
    if not trained.is_file():
        given = {"store": work / f"grid-{name}-frames"} if name in sizes.stores else {}
        given |= sizes.learning.get(name, {})
        settings = [f"--set={key}={value}" for key, value in given.items()]
        if not run(["train", "agent", name, *about, "--out", str(folder), *settings], folder, left):
            return False, {}
        trained.touch()
    figures: dict[str, Any] = {"found": {}}
    for tier in TIERS:
        for view in VIEWS[: sizes.goals]:
            path = work / f"grid-{name}-{view}-{tier}.json"
            if not path.is_file():
                settings = [f"--set={key}={value}" for key, value in sizes.judging.items()]
                words = ["eval", "agent", name, *about, "--run", str(folder), "--view", view]
                words += ["--tier", tier, "--out", str(path), *settings]
                run(words, path.with_suffix(""), end - time.monotonic())
            if path.is_file():
                told = json.loads(path.read_text(encoding="utf-8"))
                figures["trainings"] = told["runs"]
                share = told["metrics"]["success_declared"]
                figures["found"][f"{view}-{tier}"] = {
                    key: share[key] for key in ("value", "low", "high")
                }
    found = [each["value"] for each in figures["found"].values()]
    if len(found) < len(TIERS) * len(VIEWS[: sizes.goals]):
        return False, figures
    return True, figures | {"mean": sum(found) / len(found)}
