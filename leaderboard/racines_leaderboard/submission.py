"""Submissions: one YAML a system, and the weights that it names."""

from pathlib import Path
from typing import Any

import yaml

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.schema import check

REFUSED = "weights must be safetensors or ONNX files: a pickle can run code when it is loaded"


def read_submission(path: Path) -> dict[str, Any]:
    """Read and check a submission.yaml and the weights beside it.

    Raises:
        RacinesError: a missing or damaged file, an unknown or absent key, a name that is not
            its folder's under `submissions/`, weights that are pickles, absent, or of another
            digest.
    """
    try:
        document = yaml.safe_load(path.read_text())
    except FileNotFoundError as error:
        raise RacinesError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RacinesError(f"{path}: not readable as YAML: {error}") from error
    _refuse_pickles(document, path)
    check(document, "submission", str(path))
    folder = path.resolve().parent
    if folder.parent.name == "submissions" and folder.name != document["name"]:
        raise RacinesError(f"{path}: name: {document['name']!r} stands in folder {folder.name!r}")
    for i, weights in enumerate(document.get("weights", [])):
        _check_weights(folder / weights["path"], weights["sha256"], f"{path}: weights.{i}")
    return document


def find_submission(folder: Path, track: str, name: str) -> dict[str, Any] | None:
    """Return the submission of a system, or None where none was written.

    Raises:
        RacinesError: it is at fault, or belongs to the other track.
    """
    path = folder / name / "submission.yaml"
    if not path.exists():
        return None
    document = read_submission(path)
    if document["track"] != track:
        raise RacinesError(f"{path}: track: {document['track']!r}, but its scores are {track}")
    return document


def _refuse_pickles(document: Any, path: Path) -> None:
    """Say why, before the schema says only that the name does not match."""
    weights = document.get("weights") if isinstance(document, dict) else None
    for i, entry in enumerate(weights if isinstance(weights, list) else []):
        name = str(entry.get("path")) if isinstance(entry, dict) else ""
        if not name.endswith((".safetensors", ".onnx")):
            raise RacinesError(f"{path}: weights.{i}.path: {name!r} refused: {REFUSED}")


def _check_weights(path: Path, sha256: str, where: str) -> None:
    if not path.is_file():
        raise RacinesError(f"{where}: {path.name}: no such file beside the submission")
    with path.open("rb") as stream:
        head = stream.read(9)
    if head[:2] in (b"PK", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"):
        raise RacinesError(f"{where}: {path.name} holds a pickle or an archive: {REFUSED}")
    if path.suffix == ".safetensors" and head[8:9] != b"{":
        raise RacinesError(f"{where}: {path.name} is not a safetensors file")
    if (digest := sha256_file(path)) != sha256:
        raise RacinesError(f"{where}.sha256: the file has {digest}")
