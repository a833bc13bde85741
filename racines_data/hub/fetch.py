"""A dataset from the Hugging Face Hub: by its tag, its digests checked."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from racines_data.digest import check_files, refuse_strays
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest

if TYPE_CHECKING:
    from huggingface_hub import HfApi

KIND = "dataset"
STORE_FOLDER = "store/"
_TAG = re.compile(r"^(?P<source>.+)-v(?P<version>\d+\.\d+\.\d+)$")


def download(
    repo_id: str,
    version: str | None = None,
    out: Path | None = None,
    stores: bool = False,
    api: "HfApi | None" = None,
) -> Path:
    """Fetch a dataset from the Hub by its tag and check every digest.

    Files that are here already are not fetched again. Returns the dataset's folder.

    Args:
        repo_id: `OWNER/NAME` on the Hub.
        version: Version x.y.z, or a tag such as `phantom-v1.0.0`, which also works offline once it
            was fetched; default the newest.
        out: Folder to write; default the Hub's cache.
        stores: Have the training stores too, made from the shards where the Hub has none.
        api: Client of the Hub.

    Raises:
        RacinesError: no such repository or version, a damaged file, or one that is no part of
            the dataset, such as those of another version in `out`.
    """
    from huggingface_hub import HfApi

    client = api or HfApi(library_name="racines")
    with hub_errors(repo_id, "check the name, the network and HF_TOKEN, then run again"):
        tag = version if version and _TAG.match(version) else _find_tag(client, repo_id, version)
        ignored = None if stores else [f"{STORE_FOLDER}*"]
        path = client.snapshot_download(
            repo_id, repo_type=KIND, revision=tag, local_dir=out, ignore_patterns=ignored
        )
    root = Path(path)
    manifest = read_manifest(root)
    refuse_strays(root, manifest)
    wanted = {n: r for n, r in manifest["files"].items() if not n.startswith(STORE_FOLDER)}
    check_files(root, wanted, f"delete it and fetch {repo_id} again")
    if stores:
        from racines_data.store.sweeps import restore_stores

        restore_stores(root)
    return root


def _find_tag(client: "HfApi", repo_id: str, version: str | None) -> str:
    names = [ref.name for ref in client.list_repo_refs(repo_id, repo_type=KIND).tags]
    versions = {name: match["version"] for name in names if (match := _TAG.match(name))}
    if version is None:
        version = max(versions.values(), key=lambda v: [*map(int, v.split("."))], default=None)
    found = [name for name in versions if versions[name] == version]
    if len(found) == 1:
        return found[0]
    known = ", ".join(names) or "none"
    if not found:
        raise RacinesError(f"{repo_id}: no version {version or ''} there; its tags: {known}")
    raise RacinesError(
        f"{repo_id}: version {version} of several sources; name one of the tags {known}"
    )


@contextmanager
def hub_errors(repo_id: str, remedy: str) -> Iterator[None]:
    """Turn whatever the Hub's client raises into a RacinesError with the remedy."""
    try:
        yield
    except RacinesError:
        raise
    except Exception as error:  # of the client, of its transport, of its file transfer
        reason = str(error).strip().splitlines() or [""]
        raise RacinesError(
            f"{repo_id}: the Hub refused or failed ({type(error).__name__}: {reason[0]}); {remedy}"
        ) from error


def hub_files(client: "HfApi", repo_id: str, revision: str, kind: str = KIND) -> dict[str, Any]:
    """Return the files of a revision, by path, with `size` and, of large ones, `lfs.sha256`."""
    tree = client.list_repo_tree(repo_id, recursive=True, revision=revision, repo_type=kind)
    return {entry.path: entry for entry in tree if hasattr(entry, "size")}
