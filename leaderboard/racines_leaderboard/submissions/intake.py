"""Taking a submission in: every check on a copy of our own, then one rename."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from racines_data.errors import RacinesError
from racines_data.files import swap_folder
from racines_leaderboard.submissions.artefacts import YAML, files_of
from racines_leaderboard.submissions.confined.session import Limits
from racines_leaderboard.submissions.content_checks import check_content
from racines_leaderboard.submissions.document import check_measured, read_document
from racines_leaderboard.submissions.fetch import Opener, fetch, open_https
from racines_leaderboard.submissions.file_checks import measure, opened


@dataclass(frozen=True)
class Taken:
    """A submission that was taken in."""

    folder: Path
    document: dict[str, Any]
    remote: tuple[str, ...]
    """Files that were left at their URL, and not looked into."""


def take_in(
    source: Path,
    submissions: Path,
    *,
    replace: bool = False,
    fetching: bool = False,
    opener: Opener = open_https,
    limits: Limits | None = None,
) -> Taken:
    """Check a submission and copy it to `submissions/<track>/<name>/`.

    Args:
        source: Its YAML, or the folder with its submission.yaml.
        submissions: Where the folder of the submission is put.
        replace: Let it take the place of one by the same author.
        fetching: Fetch the artefacts that are absent and have a URL.
        opener: What opens a URL.
        limits: Of the process that looks into the artefacts.

    Raises:
        RacinesError: anything at fault; nothing is left behind then.
    """
    path = source / YAML if source.is_dir() else source
    document = read_document(path)
    target = submissions / document["track"] / document["name"]
    _check_free(target, document, replace, path)
    with _staged(target.parent) as stage:
        remote = _gather(path, document, stage, opener if fetching else None, limits)
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)
        (stage / YAML).write_text(text)
        for each in stage.iterdir():
            each.chmod(0o644)
        stage.chmod(0o755)
        if target.exists():
            swap_folder(stage, target)
        else:
            os.rename(stage, target)
    return Taken(target, document, remote)


def look_at(source: Path, limits: Limits | None = None) -> Taken:
    """Check a submission where it lies, as `take_in` does; nothing is written beside it.

    Its name may be taken: what is looked at may be what took it.

    Raises:
        RacinesError: anything at fault.
    """
    path = source / YAML if source.is_dir() else source
    document = read_document(path)
    with tempfile.TemporaryDirectory() as folder:
        remote = _gather(path, document, Path(folder), None, limits)
    return Taken(path.parent, document, remote)


def _check_free(target: Path, document: dict[str, Any], replace: bool, path: Path) -> None:
    """Refuse a name that is taken, unless one of its authors replaces it, and links on the way."""
    for place in (target.parent.parent, target.parent, target):
        if place.is_symlink():
            raise RacinesError(f"{place}: a symbolic link: nothing is written through it")
    if not target.exists():
        return
    if not replace:
        raise RacinesError(
            f"{path}: name: {document['name']!r} is taken ({target}): choose another, or "
            "--force to replace your own"
        )
    before = read_document(target / YAML)["authors"]
    if not set(before) & set(document["authors"]):
        raise RacinesError(
            f"{path}: authors: {target} is by {', '.join(before)}: only one of them replaces it"
        )


def _gather(
    path: Path,
    document: dict[str, Any],
    stage: Path,
    opener: Opener | None,
    limits: Limits | None,
) -> tuple[str, ...]:
    """Bring all artefacts into the stage and check what they hold; return those left remote."""
    remote = []
    for artefact in files_of(document):
        if _bring(path, artefact, stage, opener):
            check_content(stage / artefact["path"], artefact["kind"], document["track"], limits)
        else:
            remote.append(artefact["path"])
    return tuple(remote)


def _bring(path: Path, artefact: dict[str, Any], stage: Path, opener: Opener | None) -> bool:
    """Copy or fetch an artefact into the stage; False if it stays at its URL."""
    name, out = artefact["path"], stage / artefact["path"]
    if "url" in artefact and not os.path.lexists(path.parent / name):
        if opener is None:
            return False
        measured = fetch(artefact, out, opener)
    else:
        with opened(path.parent, name, str(path)) as stream, out.open("xb") as file:
            measured = measure(stream, f"{path}: {name}", file)
    check_measured(artefact, measured, str(path))
    return True


@contextmanager
def _staged(parent: Path) -> Iterator[Path]:
    """Give a folder beside the place where it will stand; what is left of it goes."""
    missing = [each for each in (parent, *parent.parents) if not each.exists()]
    parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(dir=parent, prefix=".submit-"))
    try:
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()
