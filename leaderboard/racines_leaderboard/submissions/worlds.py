"""For which task and world an agent's submission was made, by what its files say."""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.agents.onnx.policy import read_policy
from racines_envs.agents.trace import TraceAgent
from racines_envs.task.names import HEART_TIER, tier_of
from racines_envs.worlds.making import patients_recipe
from racines_leaderboard.records.tracks import AGENTS, PATIENT_AGENTS
from racines_leaderboard.submissions.document import rescored

OPENED = {"policy": lambda path: read_policy(path)[1].view, "trace": lambda p: TraceAgent(p).view}


def views_of(folder: Path, document: dict[str, Any]) -> dict[str, str]:
    """Return the tasks that a submission's policies or trace name, by their files.

    Files that lie at their URL are not asked, and a policy need not name one.
    """
    found = {}
    for artefact in rescored(document):
        if (path := folder / artefact["path"]).is_file():
            found[artefact["path"]] = OPENED[artefact["kind"]](path)
    return {name: view for name, view in found.items() if view}


def check_world(folder: Path, document: dict[str, Any], where: str) -> None:
    """Check that an agent's files were made for its track, and for the world that is here.

    Raises:
        RacinesError: a task of another track, or the digest of another world.
    """
    if document["track"] not in (AGENTS.name, PATIENT_AGENTS.name):
        return
    on_patients = document["track"] == PATIENT_AGENTS.name
    for name, view in views_of(folder, document).items():
        tier = tier_of(view)
        if on_patients == (tier == HEART_TIER):
            of = "the one heart" if on_patients else "patients"
            other = AGENTS.name if on_patients else PATIENT_AGENTS.name
            raise RacinesError(
                f"{where}: track: {document['track']}; {name} is for {view} of {of}: give track: "
                f"{other}, or a file for a task of this one"
            )
        named = document["dataset"]["digest"]
        if on_patients and named != (here := patients_recipe(tier)["recipe_digest"]):
            raise RacinesError(
                f"{where}: dataset.digest: {named}; the world of {view} is {here} here: give the "
                "one that it was made for (phantom.recipe_digest of its scores), with that version"
            )
