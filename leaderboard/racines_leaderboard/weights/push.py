"""Pushing published weights to the Hugging Face Hub: a model repository a set, with its card.

    hash every file ─> card ─> upload_folder (resumes) ─> files as published? ─> tag

The tag names the files (`racines_models.published.hub`) and is made last, never moved. A card that
says more by now, such as a board's new figures, goes to the branch alone.
"""

import hashlib
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from racines_data.errors import RacinesError
from racines_data.hub import hub_errors, hub_files
from racines_data.hub.push import check_uploaded, writing_client
from racines_leaderboard.weights.card import model_card
from racines_models.published.catalogue import Catalogue, WeightsSet, broken_files
from racines_models.published.hub import KIND, repository, tag_of

if TYPE_CHECKING:
    from huggingface_hub import HfApi

CARD = "README.md"
BRANCH = "main"
OWN = ".gitattributes"
"""What the Hub itself puts into a repository."""


@dataclass(frozen=True)
class ModelPush:
    """What a push of one set would send, and where."""

    name: str
    repo_id: str
    tag: str
    card: str
    files: dict[str, dict[str, Any]]
    """`bytes` and `sha256` of each file to send, the card included."""
    source: Path
    """Folder of the set."""

    @property
    def bytes(self) -> int:
        """Size of all files to send."""
        return sum(each["bytes"] for each in self.files.values())

    def to_json(self) -> dict[str, Any]:
        """Return the plan as JSON, without the text of the card."""
        told = {key: getattr(self, key) for key in ("name", "repo_id", "tag", "files", "bytes")}
        return told | {"repo_type": KIND, "branch": BRANCH}


def plan_pushes(catalogue: Catalogue, sets: Iterable[WeightsSet], owner: str) -> list[ModelPush]:
    """Say what pushes of sets would send, without network, after hashing every file.

    Raises:
        RacinesError: a missing or damaged file, or no name of an owner.
    """
    chosen = list(sets)
    plans = [_plan(catalogue, each, repository(owner, each)) for each in chosen]
    broken = broken_files(catalogue, chosen)
    if broken:
        told = broken[0]
        raise RacinesError(f"{told['file']}: {told['problem']}, not pushed; {told['remedy']}")
    return plans


def _plan(catalogue: Catalogue, weights: WeightsSet, repo_id: str) -> ModelPush:
    card = model_card(catalogue, weights, repo_id)
    told = {"bytes": len(card.encode()), "sha256": hashlib.sha256(card.encode()).hexdigest()}
    files = {CARD: told, **weights.files}
    source = catalogue.root / weights.folder
    return ModelPush(weights.name, repo_id, tag_of(weights), card, files, source)


def push(plan: ModelPush, private: bool = False, api: "HfApi | None" = None) -> dict[str, Any]:
    """Upload a set with its card and tag it; run again after a failure, it goes on.

    Returns the plan as JSON, with `commit`, and `tagged`: false if these files had their tag.

    Args:
        plan: What to send, by `plan_pushes`.
        private: Make the repository private, if it is new.
        api: Client of the Hub; default one with the token of the environment (`HF_TOKEN`).

    Raises:
        RacinesError: no token, the repository holds something else, or the upload fails.
    """
    client, repo = api or writing_client(), plan.repo_id
    with hub_errors(repo, "run the command again: it goes on where it stopped"):
        client.create_repo(repo, repo_type=KIND, private=private or None, exist_ok=True)
        tags = {ref.name for ref in client.list_repo_refs(repo, repo_type=KIND).tags}
        before = hub_files(client, repo, BRANCH, KIND)
        foreign = sorted({*before} - {*plan.files, OWN})
        if foreign and not any(name.startswith("weights-") for name in tags):
            raise RacinesError(
                f"{repo}: holds something else ({', '.join(foreign[:3])}), which a push would "
                "delete; rename it there, or push under another owner"
            )
        commit = _upload(client, plan)
        check_uploaded(hub_files(client, repo, commit, KIND), plan.files, repo)
        fresh = plan.tag not in tags
        if fresh:
            message = f"RACINES weights {plan.name}"
            client.create_tag(
                repo, tag=plan.tag, tag_message=message, revision=commit, repo_type=KIND
            )
    return {**plan.to_json(), "commit": commit, "tagged": fresh}


def _upload(client: "HfApi", plan: ModelPush) -> str:
    """Send the files and the card as one folder; the branch then holds nothing else."""
    with TemporaryDirectory() as folder:
        for name in plan.files:
            place = Path(folder, name)
            place.parent.mkdir(parents=True, exist_ok=True)
            if name == CARD:
                place.write_text(plan.card, encoding="utf-8")
            else:
                shutil.copyfile(plan.source / name, place)
        return client.upload_folder(
            repo_id=plan.repo_id,
            repo_type=KIND,
            folder_path=folder,
            revision=BRANCH,
            delete_patterns=["*"],
            commit_message=f"RACINES weights {plan.name}",
            commit_description=f"files as of {plan.tag}",
        ).oid
