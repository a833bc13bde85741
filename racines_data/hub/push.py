"""Pushing a dataset to the Hugging Face Hub.

    hash every file and the rows ─> tag free? ─> upload_folder (resumes) ─> files as sealed? ─> tag

A version is what its tag names, and the tag is made last: a push that fails leaves a branch that no
version points to, and is simply run again. A tag is never moved. The training stores stay here by
default: uncompressed, they are larger than all shards together, and say nothing that those do not;
`hub.download(..., stores=True)` makes them again.
"""

import glob
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyarrow import ArrowException

from racines_data.digest import check_files, refuse_strays
from racines_data.errors import RacinesError
from racines_data.hub.fetch import KIND, STORE_FOLDER, hub_errors, hub_files
from racines_data.manifest import (
    MANIFEST,
    STORES,
    config_manifest,
    describe,
    read_manifest,
    rebuild_hint,
)

if TYPE_CHECKING:
    from huggingface_hub import HfApi


@dataclass(frozen=True)
class Push:
    """What a push would send, and where."""

    repo_id: str
    revision: str
    """Branch of the Hub."""
    tag: str
    digest: str
    """Content digest of the dataset."""
    files: dict[str, dict[str, Any]]
    """`bytes` and `sha256` of each file to send, by its path; the manifest is checked by size."""
    left_out: dict[str, int]
    """Bytes of each file that stays here."""

    @property
    def bytes(self) -> int:
        """Size of all files to send."""
        return sum(record["bytes"] for record in self.files.values())

    def to_json(self) -> dict[str, Any]:
        """Return the plan as JSON."""
        return {**asdict(self), "bytes": self.bytes}


def plan_push(
    root: Path,
    repo_id: str,
    tag: str | None = None,
    revision: str = "main",
    with_store: bool = False,
    workers: int = 1,
) -> Push:
    """Say what a push would send, without network, after hashing every file and the rows.

    What an earlier check found is not relied on: a version that was published stays.

    Args:
        root: Folder of the dataset.
        repo_id: `OWNER/NAME` on the Hub.
        tag: Name of the version; default the manifest's, such as `phantom-v1.0.0`.
        revision: Branch to push to.
        with_store: Send the training stores too.
        workers: Processes that read the rows of a large dataset.

    Raises:
        RacinesError: no dataset, a missing or damaged file, one that is no part of the dataset,
            rows that do not have the recorded content digest, or a bad name of a repository.
    """
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id

    try:
        validate_repo_id(repo_id)
    except HFValidationError as error:
        raise RacinesError(f"{repo_id}: not a repository's name ({error})") from error
    manifest = read_manifest(root)
    refuse_strays(root, manifest)
    check_files(root, manifest["files"], rebuild_hint(manifest), verify=True)
    _check_content(root, manifest, workers)
    files, kept = manifest["files"], () if with_store else (STORE_FOLDER,)
    left = {name: record["bytes"] for name, record in files.items() if name.startswith(kept)}
    sent = {name: dict(record) for name, record in files.items() if name not in left}
    sent[MANIFEST] = {"bytes": (root / MANIFEST).stat().st_size}
    default = f"{manifest['source']}-v{manifest['version']}"  # of a dataset built before tags
    chosen = tag or manifest.get("tag", default)
    return Push(repo_id, revision, chosen, manifest["digest"], sent, left)


def _check_content(root: Path, manifest: dict[str, Any], workers: int) -> None:
    """Check that card and rows are those whose digest the manifest gives, not the files alone."""
    from racines_data.validate.identity import check_card, check_content, check_splits
    from racines_data.validate.survey import survey

    try:
        check_card(root, manifest)
        for config in STORES:
            if config in manifest["configs"]:
                found = survey(root, manifest, config, workers)
                own = config_manifest(manifest, config)
                check_content(found, own)
                check_splits(found, root, own)
    except (RacinesError, ArrowException, OSError, LookupError, ValueError) as error:
        said = f"{error}" if isinstance(error, RacinesError) else f"{error!r}"
        raise RacinesError(
            f"{root}: not pushed: {said}; {rebuild_hint(manifest)}, or see racines data validate"
        ) from error


def push(root: Path, plan: Push, private: bool = False, api: "HfApi | None" = None) -> dict:
    """Upload a dataset and tag it; run again after a failure, it goes on where it stopped.

    The branch then holds this dataset and nothing else; older versions stay under their tags.
    Returns the plan as JSON, with `commit`, and `uploaded`: false if the Hub had this version.

    Args:
        root: Folder of the dataset.
        plan: What to send, by `plan_push`.
        private: Make the repository private, if it is new.
        api: Client of the Hub; default one with the token of the environment (`HF_TOKEN`).

    Raises:
        RacinesError: no token, the tag is taken by other content, the repository holds something
            else, or the upload fails.
    """
    client, repo = api or writing_client(), plan.repo_id
    with hub_errors(repo, "run the command again: it goes on where it stopped"):
        client.create_repo(repo, repo_type=KIND, private=private or None, exist_ok=True)
        refs = client.list_repo_refs(repo, repo_type=KIND)
        commit = next((ref.target_commit for ref in refs.tags if ref.name == plan.tag), None)
        if commit is not None:
            _check_same(client, root, plan)
            return {**plan.to_json(), "commit": commit, "uploaded": False}
        if plan.revision != "main":
            client.create_branch(repo, branch=plan.revision, repo_type=KIND, exist_ok=True)
        _check_room(client, plan)
        commit = _upload(client, root, plan)
        check_uploaded(hub_files(client, repo, commit), plan.files, repo)
        message = describe(read_manifest(root))
        client.create_tag(repo, tag=plan.tag, tag_message=message, revision=commit, repo_type=KIND)
    return {**plan.to_json(), "commit": commit, "uploaded": True}


def writing_client() -> "HfApi":
    """Return a client of the Hub that may write; raises `RacinesError` without a token."""
    from huggingface_hub import HfApi, get_token

    if get_token() is None:
        raise RacinesError("no token for the Hub: set HF_TOKEN to one that may write")
    return HfApi(library_name="racines")


def _check_same(client: "HfApi", root: Path, plan: Push) -> None:
    """Check that the tag on the Hub is of the very files here."""
    where = f"{plan.repo_id}: tag {plan.tag}"
    if MANIFEST not in hub_files(client, plan.repo_id, plan.tag):
        raise RacinesError(f"{where} exists and is not of a RACINES dataset; choose another --tag")
    path = client.hf_hub_download(plan.repo_id, MANIFEST, repo_type=KIND, revision=plan.tag)
    there, here = read_manifest(Path(path).parent), read_manifest(root)
    if there["digest"] != here["digest"]:
        raise RacinesError(
            f"{where} holds other content (sha256 {there['digest'][:12]}, here "
            f"{here['digest'][:12]}); a tag is never moved: raise the dataset's version"
        )
    old, new = there["files"], here["files"]
    changed = sorted(name for name in {*old, *new} if old.get(name) != new.get(name))
    if changed:
        raise RacinesError(
            f"{where} holds the same content in other files ({', '.join(changed[:3])}); a tag is "
            "never moved: choose another --tag"
        )


def _check_room(client: "HfApi", plan: Push) -> None:
    tree = hub_files(client, plan.repo_id, plan.revision)
    foreign = sorted({*tree} - {*plan.files, ".gitattributes"})
    if foreign and MANIFEST not in tree:
        raise RacinesError(
            f"{plan.repo_id}: holds something else ({', '.join(foreign[:3])}), which a push would "
            "delete; name a repository of its own"
        )


def _upload(client: "HfApi", root: Path, plan: Push) -> str:
    return client.upload_folder(
        repo_id=plan.repo_id,
        repo_type=KIND,
        folder_path=root,
        revision=plan.revision,
        allow_patterns=[glob.escape(name) for name in plan.files],
        delete_patterns=["*"],  # shards of an older version; what is sent stays
        commit_message=f"RACINES {plan.tag}",
        commit_description=f"content sha256 {plan.digest}",
    ).oid


def check_uploaded(there: dict[str, Any], files: dict[str, dict[str, Any]], repo_id: str) -> None:
    """Check by size, and where the Hub tells it by sha256, that files are there as they are here.

    Raises:
        RacinesError: one that is not.
    """
    for name, record in files.items():
        file = there.get(name)
        sha256 = getattr(getattr(file, "lfs", None), "sha256", None)  # small files have none
        other = sha256 and record.get("sha256") not in (None, sha256)
        if file is None or file.size != record["bytes"] or other:
            raise RacinesError(
                f"{repo_id}: {name} is not on the Hub as it is here; nothing was tagged: run "
                "the command again"
            )
