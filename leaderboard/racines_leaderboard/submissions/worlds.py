"""For which task and world an agent's submission was made, by what its files say."""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.agents.onnx.policy import read_policy
from racines_envs.agents.trace import TraceAgent
from racines_envs.task.names import HEART_TIER, tier_of
from racines_envs.worlds.making import patients_recipe
from racines_leaderboard.records.tracks import PATIENT_AGENTS
from racines_leaderboard.submissions.document import rescored

OPENED = {"policy": lambda path: read_policy(path)[1].view, "trace": lambda p: TraceAgent(p).view}


def view_of(folder: Path, document: dict[str, Any]) -> str | None:
    """Return the task that a submission's policies or trace name; None if they name none.

    Files that lie at their URL are not asked.
    """
    view = None
    for artefact in rescored(document):
        if (path := folder / artefact["path"]).is_file():
            view = OPENED[artefact["kind"]](path) or view
    return view


def check_world(folder: Path, document: dict[str, Any], where: str) -> None:
    """Check that an agent on patients was made for the world that its task has here.

    Raises:
        RacinesError: a task on the one heart, or the digest of another world.
    """
    if document["track"] != PATIENT_AGENTS.name or (view := view_of(folder, document)) is None:
        return
    if tier_of(view) == HEART_TIER:
        raise RacinesError(
            f"{where}: track: {PATIENT_AGENTS.name}; its files are for {view} of the one heart: "
            f"name the task {view}-patients or {view}-beating, or give track: agents"
        )
    named, here = document["dataset"]["digest"], patients_recipe(tier_of(view))["recipe_digest"]
    if named != here:
        raise RacinesError(
            f"{where}: dataset.digest: {named}; the world of {view} is {here} here: give the one "
            "that it was made for (phantom.recipe_digest of its scores), with that version"
        )
