"""Loading a built dataset with its digests checked.

Heavy imports stand in the functions: the package itself imports this module.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from racines_data.errors import RacinesError
from racines_data.views import LABELS

if TYPE_CHECKING:
    from datasets import Dataset, DatasetDict, IterableDataset, IterableDatasetDict

MANIFEST = "manifest.json"
CARD = "README.md"
MULTI_PHANTOM = "multi_phantom"
"""Name of the config of many simulated hearts."""
DEFAULT_ROOT = Path("data/racines")
ROOT_VARIABLE = "RACINES_DATA"


def default_root(root: Path | str | None = None) -> Path:
    """Return the dataset's folder: the one given, that of `RACINES_DATA`, or `data/racines`."""
    return Path(root or os.environ.get(ROOT_VARIABLE) or DEFAULT_ROOT)


def rebuild_hint(manifest: Mapping[str, Any]) -> str:
    """Return what to do about a damaged dataset."""
    source = manifest.get("source", "phantom")
    return f"rebuild it: racines data build --source {source} (or fetch it again: dvc pull)"


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest of a dataset.

    Raises:
        RacinesError: there is no dataset, or its manifest is damaged.
    """
    path = root / MANIFEST
    if not path.is_file():
        raise RacinesError(
            f"{root}: no dataset here; build one: racines data build --source phantom --out {root}"
        )
    try:
        manifest = json.loads(path.read_text())
        for key in ("source", "version", "digest", "recipe_digest", "files", "counts"):
            manifest[key]
    except (ValueError, KeyError, TypeError) as error:
        raise RacinesError(f"{path}: damaged ({error}); {rebuild_hint({})}") from error
    return manifest


def config_digest(manifest: Mapping[str, Any], config: str = "frames") -> str:
    """Return the content digest of a config: `multi_phantom` has its own, the others share one."""
    return manifest[MULTI_PHANTOM]["digest"] if config == MULTI_PHANTOM else manifest["digest"]


def manifest_labels(manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the view labels of a dataset; older ones, which name none, have the cardiac ones."""
    return tuple(manifest.get("labels") or LABELS)


def check_split(split: str) -> str:
    """Return the split if it is one.

    Raises:
        RacinesError: it is not.
    """
    from racines_data.schema import SPLITS

    if split not in SPLITS:
        raise RacinesError(f"unknown split {split!r}: choose one of {', '.join(SPLITS)}")
    return split


def load(
    version: str | None = None,
    config: str = "frames",
    split: str | None = None,
    root: Path | str | None = None,
    streaming: bool = False,
    repo_id: str | None = None,
) -> "Dataset | DatasetDict | IterableDataset | IterableDatasetDict":
    """Load a dataset through `datasets`, after checking the digests of the files it reads.

    Args:
        version: The version wanted, x.y.z, or its tag; any if absent, of the Hub the newest.
        config: `frames`, `trajectories`, `sessions` or `multi_phantom`.
        split: `train`, `validation` or `test`; all if absent.
        root: The dataset's folder; default `RACINES_DATA` or `data/racines`.
        streaming: Read while iterating instead of through the cache.
        repo_id: `OWNER/NAME` on the Hugging Face Hub, to fetch the dataset from instead.

    Raises:
        RacinesError: no dataset, another version, no such config or split, or a damaged file.
    """
    import datasets

    from racines_data.card import describe
    from racines_data.digest import check_files

    if repo_id is not None:
        from racines_data.hub import download

        root = download(repo_id, version)
    folder = default_root(root)
    manifest = read_manifest(folder)
    if version not in (None, manifest["version"], manifest.get("tag")):
        raise RacinesError(
            f"{folder}: holds {manifest['source']} {manifest['version']}, not {version}; point "
            f"root or {ROOT_VARIABLE} at that version, or build it with the code that made it"
        )
    if config not in manifest["configs"]:
        known = ", ".join(manifest["configs"])
        raise RacinesError(f"{folder}: unknown config {config!r}; this dataset has {known}")
    paths = manifest["configs"][config]
    if split is not None and check_split(split) not in paths:
        raise RacinesError(f"{folder}: config {config!r} has no split {split!r}: too few rows")
    wanted = [path for name in paths for path in paths[name] if split in (None, name)]
    check_files(folder, {n: manifest["files"][n] for n in (CARD, *wanted)}, rebuild_hint(manifest))
    loaded = datasets.load_dataset(str(folder), config, split=split, streaming=streaming)
    for part in loaded.values() if isinstance(loaded, dict) else [loaded]:
        part.info.description = describe(manifest, config)
    return loaded
