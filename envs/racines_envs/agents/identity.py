"""What a checkpoint must agree in: a run's settings, and the content of all that it rests on.

Encoder, grader and generator count by the hash of their weights, not by where they lie: a run goes
on where a folder was moved, and not where it holds something else by now.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from racines_envs.agents.encoders import PoseEncoder
from racines_envs.task.rewards import get_reward
from racines_envs.worlds.backends import GRADER_FOLDER, JudgeLike, make_grader, source_weights
from racines_envs.worlds.making import WorldLike, phantom_recipe

PLACES = ("encoder", "grader", "generator")
"""Settings that name a place."""


def settings_identity(
    name: str, config: Any, seed: int, encoder: PoseEncoder | None
) -> dict[str, Any]:
    """Return the settings of a run, its encoder by content; every value is plain.

    Args:
        name: The agent's.
        config: A dataclass; places in it are left out.
        seed: Of the training.
        encoder: What looks at images, if anything does.
    """
    settings = {key: value for key, value in asdict(config).items() if key not in PLACES}
    settings |= {"hidden": list(config.hidden)}
    sha256 = encoder.sha256 if encoder is not None else None
    return {"agent": name, "seed": seed, **settings, "encoder": sha256}


def environment_identity(
    config: Any, phantom: WorldLike, grader: JudgeLike = None, data: Path | str | None = None
) -> dict[str, Any]:
    """Return what an environment is made of, by content; None for what it does without.

    Args:
        config: A `TrainingConfig`.
        phantom: The phantom.
        grader: Instead of the folder in the settings.
        data: Folder of the dataset, for the backend `replay`; data/racines by default.

    Raises:
        RacinesError: grader, generator or dataset are not there.
    """
    made: dict[str, Any] = {"grader": None, "generator": None, "data": None}
    if get_reward(config.reward).needs_judge:
        judge = make_grader(grader or config.grader or GRADER_FOLDER, "cpu")
        made["grader"] = judge.sha256
    if config.backend == "generator" and config.generator:
        made["generator"] = source_weights(config.generator)
    if config.backend == "replay":
        from racines_data.store.frames import open_store

        made["data"] = open_store(data).digest
    return made | {"phantom": phantom_recipe(phantom)}
