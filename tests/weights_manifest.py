"""Writes models/weights/manifest.json, which `racines weights` reads.

    python -m tests.weights_manifest

A set is a folder with a `config.json`, its further seeds included, or an ONNX file.
"""

import json
import subprocess
from pathlib import Path
from typing import Any

from racines_data.files import sha256_file, write_json
from racines_models.published.catalogue import CATALOGUE, SCHEMA
from racines_models.published.places import POLICIES, WEIGHTS
from tests.prose.markers import ROOT
from tests.prose.weights import ENDINGS, GROUPS, group_of, named

HUB = None
"""Who has the sets' repositories on the Hugging Face Hub; nobody so far."""


def manifest() -> dict[str, Any]:
    """Return what the manifest has to say of the weights that git tracks."""
    rows = _rows()
    sets = {}
    for place, paths in _sets().items():
        folder = Path(place) if (ROOT / place).is_dir() else Path(place).parent
        weights = [path for path in paths if path.endswith(ENDINGS)]
        hashes = {path: sha256_file(ROOT / path) for path in paths}
        boards = set().union(*(named()[hashes[path]] for path in weights))
        kind = WEIGHTS if Path(place).is_relative_to(WEIGHTS) else POLICIES
        sets[str(Path(place).relative_to(kind))] = {
            "folder": str(folder),
            "what": GROUPS[str(group_of(weights[0]))],
            "files": {
                str(Path(path).relative_to(folder)): {
                    "bytes": (ROOT / path).stat().st_size,
                    "sha256": hashes[path],
                }
                for path in paths
            },
            "boards": sorted(boards),
            "records": sorted(
                name
                for name, those in rows.items()
                # Floors share one file, which holds no more than the labels' poses.
                if those & {hashes[path] for path in weights}
                and Path(name).stem.startswith(Path(place).name)
            ),
        }
    return {"schema": SCHEMA, "hub": HUB, "sets": dict(sorted(sets.items()))}


def _sets() -> dict[str, list[str]]:
    """Return the tracked files of each set, by the set's folder or file."""
    asked = ["git", "ls-files", "-z", "--", str(WEIGHTS), str(POLICIES)]
    told = subprocess.run(asked, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    found: dict[str, list[str]] = {}
    for path in sorted(name for name in told.split("\0") if name and (ROOT / name).is_file()):
        folder = Path(path).parent
        folder = folder.parent if folder.name.startswith("seed-") else folder
        if (ROOT / folder / "config.json").is_file():
            found.setdefault(str(folder), []).append(path)
        elif path.endswith(ENDINGS):
            found[path] = [path]
    return found


def _rows() -> dict[str, set[str]]:
    """Return the hashes of the weights of each record, by its path."""
    found = {}
    for path in sorted((ROOT / "leaderboard/results").glob("*/*/*.json")):
        weights = (json.loads(path.read_text()).get("scores") or {}).get("weights") or {}
        found[str(path.relative_to(ROOT))] = set(weights.get("files", weights).values())
    return found


if __name__ == "__main__":
    write_json(ROOT / CATALOGUE, manifest())
