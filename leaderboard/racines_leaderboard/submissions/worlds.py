"""For which data, task and world a submission was made, by what its files say."""

import re
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.agents.onnx.policy import read_policy
from racines_envs.agents.trace import TraceAgent, read_trace
from racines_envs.task.names import HEART_TIER, tier_of
from racines_envs.worlds.making import patients_recipe
from racines_leaderboard.records.tracks import AGENTS, PATIENT_AGENTS
from racines_leaderboard.submissions.document import rescored
from racines_models.exchange.predictions.file import metadata_of
from racines_models.trackerless.submission import read_submission as read_motions

OPENED = {"policy": lambda path: read_policy(path)[1].view, "trace": lambda p: TraceAgent(p).view}

OF_WORLD = {"version": "version", "digest": "recipe_digest"}
SHAPES = {
    "source": re.compile(r"[A-Za-z][A-Za-z0-9_.:-]{0,99}"),
    "version": re.compile(r"[0-9]{1,4}(\.[0-9]{1,4}){2}"),
    "digest": re.compile(r"[0-9a-f]{64}"),
}
"""Of what a submission says of its data."""


def made_for(path: Path, kind: str, track: str) -> dict[str, str]:
    """Return source, version and digest of the data or world that a file says it was made for.

    Nothing, where it does not say, or cannot be read: whoever hands it in says it then.
    """
    try:
        found = _told(path, kind, track)
    except RacinesError:
        return {}
    return {key: value for key, value in found.items() if SHAPES[key].fullmatch(value)}


def _told(path: Path, kind: str, track: str) -> dict[str, str]:
    if kind == "predictions":
        told = metadata_of(path)
        kept = {key: told.get(key) for key in ("source", "version")} | {"digest": told["dataset"]}
        return {key: value for key, value in kept.items() if value}
    if kind == "motion":
        return {"digest": read_motions(path).dataset}
    world: dict[str, Any] | None = None
    if kind == "trace":
        world = read_trace(path).told["phantom"]
    elif kind == "policy" and track == PATIENT_AGENTS.name:
        view = read_policy(path)[1].view
        if view and tier_of(view) != HEART_TIER:
            world = patients_recipe(tier_of(view))
    return {key: str((world or {}).get(own, "")) for key, own in OF_WORLD.items()}


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
