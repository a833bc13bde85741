"""Digests: of files, of a dataset's content, and of the recipe that made it.

The *content* digest is of what the rows say (source, pixels, numbers, splits), not of how files
pack it, so that another PNG or Parquet library leaves it alone. Each file has its own sha256
besides.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import cache_folder, sampled_sha256, sha256_file, write_atomic
from racines_data.manifest import (
    ADDED,
    CARD,
    CROISSANT,
    DIGEST_VERSION,
    MANIFEST,
    MULTI_PHANTOM,
    PICTURES,
    REPORT,
    STORES,
    VERIFY_VARIABLE,
    check_split,
    config_manifest,
    measures_name,
    rebuild_hint,
    store_name,
)
from racines_data.schema import Trajectory


def canonical_json(value: Any) -> str:
    """Return JSON with sorted keys and no spaces: one text for equal values."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def recipe_digest(recipe: Mapping[str, Any]) -> str:
    """Return the sha256 of a recipe."""
    return hashlib.sha256(canonical_json(recipe).encode()).hexdigest()


def trajectory_digest(trajectory: Trajectory) -> str:
    """Return the sha256 of a trajectory's identity, pixels and numbers (little-endian)."""
    head = [trajectory.id, trajectory.session, trajectory.target_view, trajectory.phantom]
    head.append(len(trajectory))
    digest = hashlib.sha256(canonical_json(head).encode())
    digest.update(np.asarray(trajectory.images, dtype=np.uint8).tobytes())
    columns = ("parameters", "<f4"), ("timestamps", "<f8"), ("controls", "<f4")
    for name, dtype in (*columns, ("views", "<i8"), ("grades", "<f4")):
        digest.update(_plain(np.asarray(getattr(trajectory, name), dtype=dtype)).tobytes())
    _add_patient(digest, trajectory)
    return digest.hexdigest()


def _add_patient(digest: "hashlib._Hash", trajectory: Trajectory) -> None:
    """Add what the frames of a patient have besides; nothing for all others."""
    if trajectory.patient is not None:
        digest.update(canonical_json({"patient": trajectory.patient}).encode())
    for name, dtype in (("phases", "<f8"), ("masks", "u1"), ("turns", "<f8")):
        column = getattr(trajectory, name)
        if column is not None:
            digest.update(name.encode() + _plain(np.asarray(column, dtype=dtype)).tobytes())


def _plain(column: np.ndarray) -> np.ndarray:
    """Return a column whose NaN are all the same bits."""
    if column.dtype.kind != "f":
        return column
    return np.where(np.isnan(column), np.array(np.nan, column.dtype), column)


def content_digest(
    rows: Iterable[tuple[str, str, str]], source: str, version: int = DIGEST_VERSION
) -> str:
    """Return the digest of a dataset from (split, trajectory id, trajectory digest) in order.

    Version 1, of older datasets, leaves the source out.
    """
    digest = hashlib.sha256()
    if version > 1:
        head = {"digest": version, "source": source}
        digest.update(canonical_json(head).encode() + b"\n")
    for row in rows:
        digest.update(canonical_json(row).encode() + b"\n")
    return digest.hexdigest()


def check_files(
    root: Path, files: Mapping[str, Mapping[str, Any]], remedy: str, verify: bool = False
) -> None:
    """Check files of a dataset against their recorded sizes and sha256.

    A file is hashed whole once, and again when its inode, its size, the time of its last change of
    content or of status, or a sample of its bytes is not what it was then. The time of the status
    is the file system's own, which `touch` cannot set back. With `verify`, or where
    `RACINES_VERIFY` is set, every file is hashed whole whatever was found before.

    Raises:
        RacinesError: a file is missing, damaged, or outside the dataset, by its path; the remedy.
    """
    verify = verify or os.environ.get(VERIFY_VARIABLE, "0") not in ("", "0")
    known = _read_verified()
    fresh = dict(known)
    for name, record in files.items():
        check_inside(root, name)
        path = (root / name).resolve()
        if not path.is_file():
            raise RacinesError(f"{root / name}: missing; {remedy}")
        stat = path.stat()
        if stat.st_size != record["bytes"]:
            raise RacinesError(
                f"{root / name}: damaged ({stat.st_size} bytes, expected {record['bytes']}); "
                f"{remedy}"
            )
        times = stat.st_mtime_ns, stat.st_ctime_ns
        seal = [stat.st_ino, stat.st_size, *times, sampled_sha256(path), record["sha256"]]
        if known.get(str(path)) == seal and not verify:
            continue
        if sha256_file(path) != record["sha256"]:
            raise RacinesError(f"{root / name}: damaged (sha256 differs); {remedy}")
        fresh[str(path)] = seal
    if fresh != known:
        kept = {name: seal for name, seal in fresh.items() if Path(name).exists()}
        with suppress(OSError):  # a cache folder that cannot be written costs time, no more
            write_atomic(_verified_path(), json.dumps(kept))


def check_inside(root: Path, name: str) -> None:
    """Refuse a manifest's path that leads out of the dataset's folder."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name:
        raise RacinesError(
            f"{root / MANIFEST}: files: {name!r} lies outside the dataset; get it again from "
            "where it came from"
        )


def refuse_strays(root: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a dataset's folder with files that are no part of it.

    `datasets` reads more of a folder than the card names (a `.huggingface.yaml` there replaces the
    card's list of shards), and whoever copies the folder takes all of it for the version.

    Raises:
        RacinesError: a file that the manifest does not list, or lists without a use for it.
    """
    files = manifest["files"]
    for name in files:
        check_inside(root, name)
    strays = [name for name in _walk(root) if name not in files and not _harmless(name)]
    if strays:
        raise RacinesError(
            f"{root}: {_some(strays)} {'is' if len(strays) == 1 else 'are'} no part of the "
            "dataset (not in manifest.json): remove, or rebuild into an empty folder"
        )
    used = {CARD, CROISSANT, REPORT, *map(store_name, STORES), *map(measures_name, ADDED)}
    for shards in manifest["configs"].values():
        used.update(chain.from_iterable(shards.values()))
    for part in (manifest, *(manifest.get(config) or {} for config in (MULTI_PHANTOM, *ADDED))):
        used.update(frame["file"] for frame in part.get("canonical", ()))
    idle = [name for name in files if name not in used and not name.startswith(PICTURES)]
    if idle:
        raise RacinesError(
            f"{root / MANIFEST}: files: {_some(idle)} of no config, store, card or canonical "
            "frame: rebuild the dataset"
        )


def _walk(root: Path) -> Iterator[str]:
    """Yield all files below a folder, and links to folders, which are not followed."""
    for folder, folders, names in os.walk(root):
        linked = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        for name in sorted([*names, *linked]):
            yield Path(folder, name).relative_to(root).as_posix()


def _harmless(name: str) -> bool:
    """Return whether no reader of datasets looks at a file: file managers' and the Hub client's."""
    own = name in (MANIFEST, ".gitattributes") or name.startswith(".cache/huggingface/")
    return own or PurePosixPath(name).name in (".DS_Store", "Thumbs.db", "desktop.ini")


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def checked_shards(
    root: Path,
    manifest: Mapping[str, Any],
    config: str,
    split: str | None,
    *more: str,
    verify: bool = False,
) -> dict[str, list[str]]:
    """Return the shards of a config by split, or of one; they and `more` files are checked."""
    if config not in manifest["configs"]:
        known = ", ".join(manifest["configs"])
        add = f"; add it: racines data build --source {config} --out {root}"
        raise RacinesError(
            f"{root}: unknown config {config!r}; this dataset has {known}"
            + (add if config in ADDED else "")
        )
    shards = manifest["configs"][config]
    if split is not None and check_split(split) not in shards:
        raise RacinesError(f"{root}: config {config!r} has no split {split!r}: too few rows")
    wanted = {name: paths for name, paths in shards.items() if split in (None, name)}
    names = (*more, *chain.from_iterable(wanted.values()))
    if unsealed := [name for name in names if name not in manifest["files"]]:
        raise RacinesError(
            f"{root / MANIFEST}: {_some(unsealed)} of config {config!r} not among the files: "
            f"{rebuild_hint(manifest)}"
        )
    files = {name: manifest["files"][name] for name in names}
    check_files(root, files, rebuild_hint(config_manifest(manifest, config)), verify)
    return wanted


def _verified_path() -> Path:
    return cache_folder() / "verified.json"


def _read_verified() -> dict[str, Any]:
    try:
        content = json.loads(_verified_path().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
