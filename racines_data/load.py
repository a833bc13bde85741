"""Loading a built dataset with its digests checked.

Heavy imports stand in the functions: the package itself imports this module.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from racines_data.errors import RacinesError
from racines_data.manifest import (
    CARD,
    ROOT_VARIABLE,
    default_root,
    describe,
    digest_note,
    read_manifest,
)

if TYPE_CHECKING:
    from datasets import Dataset, DatasetDict, IterableDataset, IterableDatasetDict


def load(
    version: str | None = None,
    config: str = "frames",
    split: str | None = None,
    root: Path | str | None = None,
    streaming: bool = False,
    repo_id: str | None = None,
    verify: bool = False,
) -> "Dataset | DatasetDict | IterableDataset | IterableDatasetDict":
    """Load a dataset through `datasets`, after checking the digests of the files it reads.

    Args:
        version: The version wanted, x.y.z, or its tag; any if absent, of the Hub the newest.
        config: `frames`, `trajectories`, `sessions`, `multi_phantom`, `patients` or `beating`.
        split: `train`, `validation` or `test`; all if absent.
        root: The dataset's folder; default `RACINES_DATA` or `data/racines`.
        streaming: Read while iterating instead of through the cache.
        repo_id: `OWNER/NAME` on the Hugging Face Hub, to fetch the dataset from instead.
        verify: Hash the files again, also those that have not changed since an earlier check.

    Raises:
        RacinesError: no dataset, another version, no such config or split, a damaged file, or one
            that is no part of the dataset.
    """
    import datasets

    from racines_data.digest import checked_shards, refuse_strays

    if repo_id is not None:
        from racines_data.hub.fetch import download

        root = download(repo_id, version)
    folder = default_root(root)
    manifest = read_manifest(folder)
    if version not in (None, manifest["version"], manifest.get("tag")):
        raise RacinesError(
            f"{folder}: holds {manifest['source']} {manifest['version']}, not {version}; point "
            f"root or {ROOT_VARIABLE} at that version, or build it with the code that made it"
        )
    refuse_strays(folder, manifest)
    checked_shards(folder, manifest, config, split, CARD, verify=verify)
    loaded = datasets.load_dataset(str(folder), config, split=split, streaming=streaming)
    for part in loaded.values() if isinstance(loaded, dict) else [loaded]:
        note = digest_note(manifest)
        part.info.description = describe(manifest, config) + (f"; {note}" if note else "")
    return loaded
