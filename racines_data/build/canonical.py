"""Canonical frames: a few images by which a rebuild on another processor is recognised.

Floating point differs in the last bit between processors, so that a rebuild elsewhere may differ by
one gray level in a few pixels, and its content digest with it. It is the same version if it has the
same recipe and canonical frames within one gray level.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM, read_manifest
from racines_data.schema import PARAMETERS

TOLERANCE = 1
"""Gray levels."""


def write_canonical(
    final: Path, tables: Iterable[pa.Table], folder: str = "canonical"
) -> list[dict[str, Any]]:
    """Write the middle frame of the first trajectory of each target view.

    Args:
        final: Folder of the dataset.
        tables: Rows of `frames`, one table a trajectory, in the dataset's order.
        folder: Where to write them in the dataset.

    Returns:
        File, trajectory, frame number, target view and the twelve parameters of each.
    """
    (final / folder).mkdir(parents=True, exist_ok=True)
    chosen: dict[str, dict[str, Any]] = {}
    for table in tables:
        view = table["target_view"][0].as_py()
        if view in chosen:
            continue
        row = table.slice(len(table) // 2, 1).to_pylist()[0]
        name = f"{folder}/{view}.png"
        (final / name).write_bytes(row["image"]["bytes"])
        keys = "trajectory", "frame", "target_view"
        parameters = {key: row[key] for key in PARAMETERS}
        chosen[view] = {"file": name, **{key: row[key] for key in keys}, "parameters": parameters}
    return list(chosen.values())


def same_version(root: Path, other: Path) -> str:
    """Say how two builds of one version differ.

    Raises:
        RacinesError: they are not the same version.
    """
    one, two = read_manifest(root), read_manifest(other)
    for key in ("source", "version", "recipe_digest"):
        if one[key] != two[key]:
            raise RacinesError(f"{key} is {one[key]} here and {two[key]} in {other}")
    more = [manifest.get(MULTI_PHANTOM, {}) for manifest in (one, two)]
    if one["digest"] == two["digest"] and more[0].get("digest") == more[1].get("digest"):
        return "equal, byte for byte"
    furthest = 0
    for frame in [*one["canonical"], *more[0].get("canonical", [])]:
        images = [np.asarray(Image.open(folder / frame["file"]), int) for folder in (root, other)]
        furthest = max(furthest, int(np.abs(images[0] - images[1]).max()))
    if furthest > TOLERANCE:
        raise RacinesError(f"canonical frames differ by {furthest} gray levels from {other}")
    return f"same recipe; content differs, canonical frames by {furthest} gray level at most"
