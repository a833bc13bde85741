"""The manifest of a built dataset: what it holds, where, and under which digests."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.views import LABELS, check_labels

METADATA = b"racines.store"
MANIFEST = "manifest.json"
CARD = "README.md"
CROISSANT = "croissant.json"
REPORT = "import_report.parquet"
PICTURES = "card/"  # folder of what the card shows
MULTI_PHANTOM = "multi_phantom"  # the config of many simulated hearts
DEFAULT_ROOT = Path("data/racines")
ROOT_VARIABLE = "RACINES_DATA"
VERIFY_VARIABLE = "RACINES_VERIFY"  # hash every file again, as `racines --verify` does
DIGEST_VERSION = 2
"""What a content digest is of. 1: splits, ids and trajectories; 2: the source as well, so that
frames of a simulator cannot be passed off as recorded ones. A manifest that names none has 1."""
ADDED = ("patients", "beating")
"""Configs of simulated patients: still hearts, and hearts that beat and breathe. A source of the
same name adds each to a dataset that stands. It has a source, a version, a recipe, digests and
counts of its own, under its name in the manifest, and more columns than `frames`."""
UNKNOWN_SCALE = "unknown"
"""What `scale` of a manifest says where the size of a pixel is not known."""
STORES = ("frames", MULTI_PHANTOM, *ADDED)
"""Configs with a store; `sessions` are rows of `frames`."""


def default_root(root: Path | str | None = None) -> Path:
    """Return the dataset's folder: the one given, that of `RACINES_DATA`, or `data/racines`."""
    return Path(root or os.environ.get(ROOT_VARIABLE) or DEFAULT_ROOT)


def rebuild_hint(manifest: Mapping[str, Any]) -> str:
    """Return what to do about a damaged dataset."""
    source = manifest.get("source", "phantom")
    return f"rebuild it: racines data build --source {source} (or fetch it again: dvc pull)"


def read_manifest(root: Path) -> dict[str, Any]:
    """Read a manifest; raise `RacinesError` if there is no dataset, or its manifest is damaged."""
    path = root / MANIFEST
    if not path.is_file():
        raise RacinesError(
            f"{root}: no dataset here; build one: racines data build --source phantom --out {root}"
        )
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        for key in ("source", "version", "digest", "recipe_digest", "files", "counts"):
            manifest[key]
        version = digest_version(manifest)
    except (ValueError, KeyError, TypeError) as error:
        raise RacinesError(f"{path}: damaged ({error}); {rebuild_hint({})}") from error
    if version not in range(1, DIGEST_VERSION + 1):
        raise RacinesError(
            f"{path}: digest_version {version!r} is unknown here, where {DIGEST_VERSION} is the "
            "newest: update racines"
        )
    return manifest


def digest_version(manifest: Mapping[str, Any]) -> int:
    """Return what the content digest of a dataset is of; see `DIGEST_VERSION`."""
    return manifest.get("digest_version", 1)


def digest_note(manifest: Mapping[str, Any]) -> str:
    """Return what to say beside the content digest of an older dataset; nothing of a new one."""
    if digest_version(manifest) == DIGEST_VERSION:
        return ""
    return f"digest version {digest_version(manifest)}, which leaves the source out"


def config_digest(manifest: Mapping[str, Any], config: str = "frames") -> str:
    """Return the content digest of a config: `frames`, `sessions`, `trajectories` share one."""
    own = config in (MULTI_PHANTOM, *ADDED)
    return manifest[config]["digest"] if own else manifest["digest"]


def added_configs(manifest: Mapping[str, Any]) -> list[str]:
    """Return the names of the configs that sources have added to a dataset."""
    return [name for name in ADDED if name in manifest.get("configs", ())]


def config_manifest(manifest: Mapping[str, Any], config: str) -> dict[str, Any]:
    """Return the manifest as it is of a config: of an added one, source and recipe are its own."""
    if config not in ADDED or config not in manifest:
        return dict(manifest)
    # What is said of a rotation about the apex is of the recorded frames alone.
    return {**manifest, "turns": None, "scale": None, **manifest[config]}


def is_turned(manifest: Mapping[str, Any]) -> bool:
    """Return whether the frames are of a rotation about the apex, with phases and angles."""
    return bool(manifest.get("turns"))


def scale_known(manifest: Mapping[str, Any]) -> bool:
    """Return whether positions are in metres; else they are in pixels of the recorded images.

    Where they are not, nothing may be told in millimetres.
    """
    return manifest.get("scale") != UNKNOWN_SCALE


def manifest_labels(manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the view labels of a dataset; older ones, which name none, have the cardiac ones.

    Raises:
        RacinesError: one cannot be part of a file's name.
    """
    return check_labels(manifest.get("labels") or LABELS, f"{MANIFEST}: labels")


def check_split(split: str) -> str:
    """Return the split if it is one; else raise `RacinesError`."""
    from racines_data.schema import SPLITS

    if split not in SPLITS:
        raise RacinesError(f"unknown split {split!r}: choose one of {', '.join(SPLITS)}")
    return split


def store_name(config: str) -> str:
    """Return the file of a config's store in the dataset."""
    return f"store/{config}.arrow"


def measures_name(config: str) -> str:
    """Return the file with the true measures of an added config's patients, in the dataset."""
    return f"measures/{config}.parquet"


def describe(manifest: Mapping[str, Any], config: str = "frames") -> str:
    """Return the description of a config.

    It carries the digest because `datasets` keys its cache of a local folder by the configs, not by
    the content of the files: without it a rebuilt dataset would be served stale. So it does the
    grader's hash, where one has annotated the frames.
    """
    from racines_data.sources.base import manifest_card

    manifest = config_manifest(manifest, config)
    card = manifest_card(manifest)
    annotation = manifest.get("annotation") if config in ("frames", "sessions") else None
    return (
        f"source {manifest['source']} ({card.origin}); version {manifest['version']}; "
        f"content sha256 {config_digest(manifest, config)}"
        + (f"; annotated by grader {annotation['grader']}" if annotation else "")
        + (f"; licence {card.license}" if manifest.get("card") else "")
    )
