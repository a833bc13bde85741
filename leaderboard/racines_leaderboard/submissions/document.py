"""A submission's YAML, read as what a stranger wrote: plain data, bounded, one meaning only."""

import math
import unicodedata
from pathlib import Path
from typing import Any

import yaml

from racines_data.errors import RacinesError
from racines_leaderboard.records.schema import check
from racines_leaderboard.submissions.artefacts import (
    YAML,
    check_artefacts,
    files_of,
    measure,
    opened,
    read_bounded,
)

MAX_BYTES = 64 * 2**10
MAX_DEPTH = 12
CONTROLS = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Unicode categories that cannot be seen, or that turn the text around them."""


class _PlainLoader(yaml.SafeLoader):
    """Safe YAML without what makes it more than data: aliases, merges, doubled keys, depth."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are refused: write the value out")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError(f"nested more than {MAX_DEPTH} deep")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value]
        for key in keys:
            if not isinstance(key, str) or key == "<<" or keys.count(key) > 1:
                raise yaml.YAMLError(f"key {str(key)[:80]!r}: refused, or stands twice")
        return super().construct_mapping(node, deep)


def _check_text(value: Any, where: str) -> None:
    """Check that every text can be shown on one line as it is, and every number is finite."""
    if isinstance(value, dict):
        for key, each in value.items():
            _check_text(key, where)
            _check_text(each, f"{where}: {key}")
    elif isinstance(value, list):
        for i, each in enumerate(value):
            _check_text(each, f"{where}.{i}")
    elif isinstance(value, str):
        bad = next((c for c in value if unicodedata.category(c) in CONTROLS), None)
        if bad is not None:
            raise RacinesError(f"{where}: character U+{ord(bad):04X} refused: visible text only")
    elif isinstance(value, float) and not math.isfinite(value):
        raise RacinesError(f"{where}: {value}: give a finite number, or leave it out")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise RacinesError(f"{where}: a number beyond 64 bits")


def read_document(path: Path) -> dict[str, Any]:
    """Read and check a submission's YAML, not the files that it names.

    Refused: more than 64 KiB or than plain data, a faulty field, an artefact that may not be.
    """
    content = read_bounded(path.parent, path.name, str(path.parent), MAX_BYTES)
    try:
        document = yaml.load(content.decode(), _PlainLoader)
    except (UnicodeDecodeError, ValueError, yaml.YAMLError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as YAML: {error}") from error
    _check_text(document, str(path))
    if isinstance(document, dict) and document.get("schema") != "racines.submission/2":
        raise RacinesError(
            f"{path}: schema: give racines.submission/2 (a template: racines submit --new FOLDER)"
        )
    check(document, "submission", str(path))
    check_artefacts(document, str(path))
    return document


def read_submission(path: Path) -> dict[str, Any]:
    """Read a submission, and check that its artefacts are those that the YAML names.

    An artefact with a URL may be absent. None may be a link, too large, a pickle or an archive, or
    of another size or digest.
    """
    document = read_document(path)
    for artefact in files_of(document):
        check_file(path.parent, artefact, str(path))
    return document


def check_file(folder: Path, artefact: dict[str, Any], where: str) -> bool:
    """Check one artefact's file as `read_submission` does; return whether it is there."""
    name = artefact["path"]
    if "url" in artefact and not (folder / name).is_symlink() and not (folder / name).exists():
        return False
    with opened(folder, name, where) as stream:
        check_measured(artefact, measure(stream, f"{where}: {name}"), where)
    return True


def check_measured(artefact: dict[str, Any], measured: tuple[str, int], where: str) -> None:
    """Check that the digest and size that were found are those that the entry claims."""
    digest, size = measured
    if (digest, size) != (artefact["sha256"], artefact["size"]):
        raise RacinesError(
            f"{where}: {artefact['path']}: the file has sha256 {digest} and {size} bytes, the "
            f"entry says {artefact['sha256']} and {artefact['size']}: write what the file has"
        )


def find_submission(folder: Path, track: str, name: str) -> dict[str, Any] | None:
    """Return the submission of a system, which stands where it says; None if none was written."""
    path = folder / track / name / YAML
    if (folder / name / YAML).exists():
        raise RacinesError(f"{folder / name}: move it to {folder / track / name}")
    for place in (path.parent.parent, path.parent):
        if place.is_symlink():
            raise RacinesError(f"{place}: a symbolic link: put the folder itself there")
    if not path.exists():
        return None
    document = read_submission(path)
    for key, value in (("track", track), ("name", name)):
        if document[key] != value:
            raise RacinesError(f"{path}: {key}: {document[key]!r}, expected {value!r} by its place")
    files = {entry["path"] for entry in files_of(document)}
    known = {YAML, ".gitignore", *files, *(f"{name}.dvc" for name in files)}
    for each in sorted(path.parent.iterdir()):
        if each.name not in known:
            raise RacinesError(f"{each}: no artefact of {path}: name it there, or remove it")
    return document
