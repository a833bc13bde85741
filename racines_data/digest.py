"""Digests: of files, of a dataset's content, and of the recipe that made it.

The *content* digest is of what the rows say (pixels, numbers, splits), not of how files pack it,
so that another PNG or Parquet library leaves it alone. Each file has its own sha256 besides.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic
from racines_data.manifest import check_split, rebuild_hint
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
        column = np.asarray(getattr(trajectory, name), dtype=dtype)
        if column.dtype.kind == "f":
            column = np.where(np.isnan(column), np.array(np.nan, dtype), column)
        digest.update(column.tobytes())
    return digest.hexdigest()


def content_digest(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return the digest of a dataset from (split, trajectory id, trajectory digest) in order."""
    digest = hashlib.sha256()
    for row in rows:
        digest.update(canonical_json(row).encode() + b"\n")
    return digest.hexdigest()


def check_files(root: Path, files: Mapping[str, Mapping[str, Any]], remedy: str) -> None:
    """Check files of a dataset against their recorded sizes and sha256.

    A file whose size and modification time are those of an earlier check is not read again.

    Raises:
        RacinesError: a file is missing or damaged, by its path, with the remedy.
    """
    known = _read_verified()
    fresh = dict(known)
    for name, record in files.items():
        path = (root / name).resolve()
        if not path.is_file():
            raise RacinesError(f"{root / name}: missing; {remedy}")
        stat = path.stat()
        if stat.st_size != record["bytes"]:
            raise RacinesError(
                f"{root / name}: damaged ({stat.st_size} bytes, expected {record['bytes']}); "
                f"{remedy}"
            )
        seal = [stat.st_size, stat.st_mtime_ns, record["sha256"]]
        if known.get(str(path)) == seal:
            continue
        if sha256_file(path) != record["sha256"]:
            raise RacinesError(f"{root / name}: damaged (sha256 differs); {remedy}")
        fresh[str(path)] = seal
    if fresh != known:
        kept = {name: seal for name, seal in fresh.items() if Path(name).exists()}
        with suppress(OSError):  # a cache folder that cannot be written costs time, no more
            write_atomic(_verified_path(), json.dumps(kept))


def checked_shards(
    root: Path, manifest: Mapping[str, Any], config: str, split: str | None, *more: str
) -> dict[str, list[str]]:
    """Return the shards of a config by split, or of one; they and `more` files are checked."""
    if config not in manifest["configs"]:
        known = ", ".join(manifest["configs"])
        raise RacinesError(f"{root}: unknown config {config!r}; this dataset has {known}")
    shards = manifest["configs"][config]
    if split is not None and check_split(split) not in shards:
        raise RacinesError(f"{root}: config {config!r} has no split {split!r}: too few rows")
    wanted = {name: paths for name, paths in shards.items() if split in (None, name)}
    names = (*more, *chain.from_iterable(wanted.values()))
    check_files(root, {name: manifest["files"][name] for name in names}, rebuild_hint(manifest))
    return wanted


def _verified_path() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "racines" / "verified.json"


def _read_verified() -> dict[str, Any]:
    try:
        content = json.loads(_verified_path().read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
