"""Checks of a dataset's files against its manifest: bytes, card, recipe."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import yaml

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.manifest import CARD, describe


def rehash_files(root: Path, manifest: dict[str, Any], workers: int = 1) -> str:
    """Hash every file again, whatever an earlier check found.

    Raises:
        RacinesError: a file is missing or damaged, or a config names one that is not listed.
    """
    files = manifest["files"]
    for config, splits in manifest["configs"].items():
        for name in (name for names in splits.values() for name in names):
            if name not in files:
                raise RacinesError(f"{name} of config {config} is not among the manifest's files")
    for name in files:
        if not (root / name).is_file():
            raise RacinesError(f"{name} is missing")
    with ThreadPoolExecutor(workers) as pool:  # hashing runs outside the interpreter's lock
        hashes = pool.map(lambda name: sha256_file(root / name), files)
        for (name, record), found in zip(files.items(), hashes, strict=True):
            if found != record["sha256"]:
                raise RacinesError(f"{name} is damaged: its sha256 differs")
    size = sum(record["bytes"] for record in files.values())
    return f"{len(files)} files, {size / 1e6:.1f} MB, every sha256 as recorded"


def check_card(root: Path, manifest: dict[str, Any]) -> str:
    """Check that the card describes this content, and names the manifest's configs and files.

    Raises:
        RacinesError: another dataset's card; `datasets` would serve other rows.
    """
    text = (root / CARD).read_text()
    try:
        head = yaml.safe_load(text.split("---\n", 2)[1])
        configs = {config["config_name"]: config for config in head["configs"]}
        named = {
            name: {part["split"]: part["path"] for part in config["data_files"]}
            for name, config in configs.items()
        }
    except (yaml.YAMLError, IndexError, KeyError, TypeError) as error:
        raise RacinesError(f"{CARD}: its YAML header cannot be read: {error}") from error
    for name, config in configs.items():
        if config.get("description") != describe(manifest, name):
            raise RacinesError(f"{CARD} describes another dataset: its digest or source differs")
    if named != manifest["configs"]:
        raise RacinesError(f"{CARD} names other configs, splits or files than the manifest")
    return f"names the source, the content digest and {len(named)} configs"


def check_recipe(manifest: dict[str, Any]) -> str:
    """Check the recipe digest.

    Raises:
        RacinesError: the recipe does not have it.
    """
    if recipe_digest(manifest["recipe"]) != manifest["recipe_digest"]:
        raise RacinesError("the recipe does not have the recorded recipe digest")
    return manifest["recipe_digest"][:16]
