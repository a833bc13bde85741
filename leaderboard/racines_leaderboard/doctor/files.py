"""Whether datasets and weights are whole: cheaply, by their manifests and the sizes of files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.manifest import MANIFEST, default_root, read_manifest, rebuild_hint
from racines_models.published.catalogue import CATALOGUE, broken_files, read_catalogue
from racines_models.published.places import published

DATA = Path("data")


def datasets(folder: Path = DATA) -> list[dict[str, Any]]:
    """Return each dataset in a folder, and the default one, with what is broken of it."""
    roots = {path.parent for path in folder.glob(f"*/{MANIFEST}")}
    roots |= {root for root in [default_root()] if (root / MANIFEST).exists()}
    return [_dataset(root) for root in sorted(roots)]


def _dataset(root: Path) -> dict[str, Any]:
    try:
        manifest = read_manifest(root)
        broken = list(_broken(root, manifest["files"], rebuild_hint(manifest)))
        told = f"{manifest['source']} {manifest['version']}"
    except RacinesError as error:
        problem, _, remedy = str(error).removeprefix(f"{root / MANIFEST}: ").partition("; ")
        file = str(root / MANIFEST)
        return {"root": str(root), "what": "unknown", "files": 0, "bytes": 0,
                "broken": [{"file": file, "problem": problem, "remedy": remedy}]}  # fmt: skip
    size = sum(each["bytes"] for each in manifest["files"].values())
    return {"root": str(root), "what": told, "files": len(manifest["files"]), "bytes": size,
            "broken": broken}  # fmt: skip


def _broken(root: Path, files: dict[str, Any], remedy: str) -> Iterator[dict[str, str]]:
    for name, told in files.items():
        path = root / name
        if not path.is_file():
            yield {"file": str(path), "problem": "missing", "remedy": remedy}
        elif (size := path.stat().st_size) != told["bytes"]:
            problem = f"damaged ({size} bytes, expected {told['bytes']})"
            yield {"file": str(path), "problem": problem, "remedy": remedy}


def weights(full: bool = False) -> dict[str, Any]:
    """Return how many published sets and files are here, and what is broken; None for none here.

    With `full` every file is hashed; or else sizes alone are compared.
    """
    path = published(CATALOGUE)
    if not path.is_file():
        return {"root": None, "sets": 0, "files": 0, "bytes": 0, "full": full, "broken": []}
    try:
        catalogue = read_catalogue()
    except RacinesError as error:
        problem, _, remedy = str(error).removeprefix(f"{path}: ").partition("; ")
        broken = [{"file": str(path), "problem": problem, "remedy": remedy}]
        return {"root": None, "sets": 0, "files": 0, "bytes": 0, "full": full, "broken": broken}
    sets = list(catalogue.sets.values())
    return {
        "root": str(catalogue.root),
        "sets": len(sets),
        "files": sum(len(each.files) for each in sets),
        "bytes": sum(each.bytes for each in sets),
        "full": full,
        "broken": broken_files(catalogue, sets, full),
    }
