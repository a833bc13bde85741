"""Submissions: one folder a system, with one YAML and the artefacts that it names."""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.records.schema import check
from racines_leaderboard.submissions.artefacts import YAML, check_artefacts, files_of
from racines_leaderboard.submissions.file_checks import measure, opened
from racines_leaderboard.submissions.text import read_yaml


def read_document(path: Path) -> dict[str, Any]:
    """Read and check a submission's YAML, not the files that it names.

    Raises:
        RacinesError: no regular file, not plain YAML, an unknown, absent or faulty field, or an
            artefact that may not be.
    """
    document = read_yaml(path.parent, path.name)
    if isinstance(document, dict) and document.get("schema") != "racines.submission/2":
        raise RacinesError(
            f"{path}: schema: give racines.submission/2 (a template: racines submit --new FOLDER)"
        )
    check(document, "submission", str(path))
    check_artefacts(document, str(path))
    return document


def read_submission(path: Path) -> dict[str, Any]:
    """Read a submission, and check that its artefacts are those that the YAML names.

    An artefact with a URL may be absent.

    Raises:
        RacinesError: as `read_document`; a file that is absent, no regular file, too large, a
            pickle or an archive, or of another size or digest.
    """
    document = read_document(path)
    for artefact in files_of(document):
        check_file(path.parent, artefact, str(path))
    return document


def check_file(folder: Path, artefact: dict[str, Any], where: str) -> bool:
    """Check one artefact's file against its entry; return whether it is there.

    Raises:
        RacinesError: see `read_submission`.
    """
    name = artefact["path"]
    if "url" in artefact and not (folder / name).is_symlink() and not (folder / name).exists():
        return False
    with opened(folder, name, where) as stream:
        check_measured(artefact, measure(stream, f"{where}: {name}"), where)
    return True


def check_measured(artefact: dict[str, Any], measured: tuple[str, int], where: str) -> None:
    """Check the digest and size that were found against those that the entry claims.

    Raises:
        RacinesError: they differ.
    """
    digest, size = measured
    if (digest, size) != (artefact["sha256"], artefact["size"]):
        raise RacinesError(
            f"{where}: {artefact['path']}: the file has sha256 {digest} and {size} bytes, the "
            f"entry says {artefact['sha256']} and {artefact['size']}: write what the file has"
        )


def find_submission(folder: Path, track: str, name: str) -> dict[str, Any] | None:
    """Return the submission of a system, or None where none was written.

    Raises:
        RacinesError: it is at fault, or does not stand where its track and name say.
    """
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
