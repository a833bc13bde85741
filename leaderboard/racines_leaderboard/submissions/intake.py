"""Taking a submission in: every check on a copy of our own, then one rename.

Artefacts at a URL are fetched when asked for, bounded, and kept only if the digest is right. What
they hold is looked at before anything is run: headers first, then a confined parse.
"""

import contextlib
import json
import os
import shutil
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.client import HTTPMessage
from pathlib import Path
from typing import IO, Any, BinaryIO
from urllib.error import URLError

import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from safetensors import SafetensorError, deserialize

from racines_data.errors import RacinesError
from racines_data.files import locked, swap_folder
from racines_envs.agents.onnx.policy import read_policy
from racines_envs.agents.trace import read_trace
from racines_leaderboard.board.robustness import read_report
from racines_leaderboard.records.names import check_unlike
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.records.tracks import TRACK
from racines_leaderboard.submissions.confined.session import Limits, rehearse
from racines_leaderboard.submissions.document import (
    MAX_BYTES,
    YAML,
    check_measured,
    files_of,
    measure,
    opened,
    read_bounded,
    read_document,
)
from racines_leaderboard.submissions.probe import Probed, matching_store, probe
from racines_leaderboard.submissions.worlds import check_world
from racines_models.exchange.onnx.generator import read_onnx
from racines_models.trackerless.submission import read_submission as read_motions

SECONDS = 60
"""The longest that a server may be silent."""
WHOLE_SECONDS = 1800
"""The longest that it may take in all."""
Opener = Callable[[str], BinaryIO]
MAX_UNPACKED = 2**30
MAX_ROWS = 1_000_000
MAX_GROUPS = 10_000
MAX_FOOTER = 8 * 2**20
MAX_HEADER = 10 * 2**20
MAX_JSON = 20 * 2**20


class _SameScheme(urllib.request.HTTPRedirectHandler):
    """Follows a redirection to https only: not to a file, nor in the clear."""

    def redirect_request(
        self, req: Any, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> Any:
        if not newurl.startswith("https://"):
            raise RacinesError(f"{req.full_url}: leads to {newurl[:200]!r}, which is not https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def open_https(url: str) -> BinaryIO:
    """Open a URL; only https, redirections included."""
    if not url.startswith("https://"):
        raise URLError(f"unknown url type: {url.partition(':')[0]}")
    return urllib.request.build_opener(_SameScheme).open(url, timeout=SECONDS)


class _Bounded:
    """A stream that ends in an error once it gives more, or takes longer, than it may."""

    def __init__(self, stream: BinaryIO, size: int, url: str) -> None:
        self._stream, self._left, self._size, self._url = stream, size, size, url
        self._end = time.monotonic() + WHOLE_SECONDS

    def read(self, count: int = 2**20, /) -> bytes:
        chunk = self._stream.read(min(count, self._left + 1))
        self._left -= len(chunk)
        if time.monotonic() > self._end:
            raise RacinesError(f"{self._url}: took more than {WHOLE_SECONDS} s: stopped")
        if self._left < 0:
            raise RacinesError(f"{self._url}: more than the {self._size:,} bytes of its entry")
        return chunk


@dataclass(frozen=True)
class Taken:
    """A submission that was taken in."""

    folder: Path
    document: dict[str, Any]
    remote: tuple[str, ...]
    """Files that were left at their URL, and not looked into."""
    probed: Probed
    """What of the contract holds, and what could not be told."""


def take_in(
    source: Path,
    submissions: Path,
    *,
    replace: bool = False,
    fetching: bool = False,
    opener: Opener = open_https,
    limits: Limits | None = None,
    data: Path | None = None,
) -> Taken:
    """Check a submission, its YAML or the folder with it; copy it to `submissions/<track>/<name>/`.

    With `replace` it may take the place of one by the same author. With `fetching`, artefacts that
    are absent and have a URL are fetched through `opener`. What looks into them has `limits`. The
    contract is tried on them (see `probe`), with the dataset in `data`, if it is the one they name.
    Processes that take in at the same time put their submissions in place one after the other.

    Raises:
        RacinesError: anything at fault; nothing is left behind then.
    """
    path = source / YAML if source.is_dir() else source
    document = read_document(path)
    target = submissions / document["track"] / document["name"]
    _check_free(target, document, replace, path)
    with _staged(target.parent) as stage, _where_it_lies(stage, path.parent):
        remote = _gather(path, document, stage, opener if fetching else None, limits)
        check_world(stage, document, str(path))
        probed = probe(stage, document, matching_store(data, document), limits)
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)
        (stage / YAML).write_text(text, encoding="utf-8")
        for each in stage.iterdir():
            each.chmod(0o644)
        stage.chmod(0o755)
        with locked(submissions):
            _check_free(target, document, replace, path)
            if target.exists():
                swap_folder(stage, target)
            else:
                os.rename(stage, target)
    return Taken(target, document, remote, probed)


def look_at(
    source: Path, submissions: Path, limits: Limits | None = None, data: Path | None = None
) -> Taken:
    """Check a submission where it lies, as `take_in` does; nothing is written beside it.

    Its name may be taken: what is looked at may be what took it.
    """
    path = source / YAML if source.is_dir() else source
    document = read_document(path)
    _check_own(submissions / document["track"] / document["name"], document, path)
    with tempfile.TemporaryDirectory() as folder, _where_it_lies(Path(folder), path.parent):
        remote = _gather(path, document, Path(folder), None, limits)
        check_world(Path(folder), document, str(path))
        probed = probe(Path(folder), document, matching_store(data, document), limits)
    return Taken(path.parent, document, remote, probed)


@contextlib.contextmanager
def _where_it_lies(copies: Path, source: Path) -> Iterator[None]:
    """Name in errors the files that were handed in, not the copies, which are gone by then."""
    try:
        yield
    except RacinesError as error:
        told = str(error).replace(str(copies), str(source))
        if told == str(error):
            raise
        raise RacinesError(told) from error


def _check_free(target: Path, document: dict[str, Any], replace: bool, path: Path) -> None:
    """Refuse a name that is taken, unless one of its authors replaces it, and links on the way.

    A name that looks like one that is taken is refused, and a file that was handed in before.
    """
    for place in (target.parent.parent, target.parent, target):
        if place.is_symlink():
            raise RacinesError(f"{place}: a symbolic link: nothing is written through it")
    beside = [each.name for each in target.parent.glob("[!.]*")]
    check_unlike(target.name, beside, f"{path}: name")
    _check_own(target, document, path)
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


def _check_own(target: Path, document: dict[str, Any], path: Path) -> None:
    """Refuse a file that was handed in before, under another name or in another track."""
    own = {each["sha256"]: each["path"] for each in files_of(document)}
    for other in sorted(target.parent.parent.glob(f"*/[!.]*/{YAML}")):
        for sha256 in own.keys() & _handed_in(other) if other.parent != target else ():
            there = f"{other.parent.parent.name}/{other.parent.name}"
            taken = f"handed in as {there} already"
            raise RacinesError(f"{path}: {own[sha256]}: {taken}: hand in what is your own")


def _handed_in(path: Path) -> set[str]:
    """Return the digests of a submission's files; none where it is faulty."""
    try:
        return {each["sha256"] for each in files_of(read_document(path))}
    except RacinesError:
        return set()


def _gather(
    path: Path, document: dict[str, Any], stage: Path, opener: Opener | None, limits: Limits | None
) -> tuple[str, ...]:
    """Bring all artefacts into the stage and check what they hold; return those left remote."""
    remote = []
    for artefact in files_of(document):
        name, out = artefact["path"], stage / artefact["path"]
        if "url" not in artefact or os.path.lexists(path.parent / name):
            with opened(path.parent, name, str(path)) as stream, out.open("xb") as file:
                measured = measure(stream, f"{path}: {name}", file)
        elif opener is not None:
            measured = _fetch(artefact["url"], artefact["size"], out, opener)
        else:
            remote.append(name)
            continue
        check_measured(artefact, measured, str(path))
        check_content(out, artefact["kind"], document["track"], limits)
    return tuple(remote)


def _fetch(url: str, size: int, out: Path, opener: Opener) -> tuple[str, int]:
    """Fetch at most `size` bytes into a new file; return its digest and size."""
    try:
        with opener(url) as stream, out.open("xb") as file:
            return measure(_Bounded(stream, size, url), url, file)
    except (OSError, ValueError) as error:
        raise RacinesError(f"{url}: cannot be fetched: {error}") from error


@contextlib.contextmanager
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


def check_content(path: Path, kind: str, track: str, limits: Limits | None = None) -> None:
    """Check that a file holds what its kind says, within bounds; nothing of it is run.

    Refused: another format or interface, a claim or content beyond the bounds, external data,
    operators beyond the standard, numbers that are not finite.
    """
    limit = MAX_JSON if path.suffix == ".json" else MAX_BYTES
    content = read_bounded(path.parent, path.name, str(path.parent), limit)
    if kind in ("predictions", "motion"):
        check_parquet(content, str(path))
        rehearse("parquet", content, str(path), limits)
        if kind == "motion":
            read_motions(path)
    elif kind in ("generator", "policy"):
        rehearse("onnx", content, str(path), limits)
        read = read_onnx if kind == "generator" else read_policy
        read(path)
    elif kind == "weights":
        check_safetensors(content, str(path))
    elif kind == "trace":
        read_trace(path)
    elif kind == "scores":
        read_json(path, TRACK[track].schema)
    elif kind == "robustness":
        read_report(path)


def check_parquet(content: bytes, where: str) -> None:
    """Check a Parquet file's marks, and by its footer how much it says that it holds."""
    footer = int.from_bytes(content[-8:-4], "little")
    if len(content) < 12 or content[:4] != b"PAR1" or content[-4:] != b"PAR1":
        raise RacinesError(f"{where}: not a Parquet file: write it again")
    if footer > min(MAX_FOOTER, len(content) - 12):
        raise RacinesError(f"{where}: a footer of {footer:,} bytes: at most {MAX_FOOTER:,}")
    try:
        stated = pq.read_metadata(pa.BufferReader(content))
        groups = [stated.row_group(i) for i in range(min(stated.num_row_groups, MAX_GROUPS + 1))]
        columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    except Exception as error:
        raise RacinesError(f"{where}: not readable as Parquet: {error}; write it again") from error
    sizes = [column.total_uncompressed_size for column in columns]
    rows, unpacked = stated.num_rows, sum(sizes)
    if rows > MAX_ROWS or unpacked > MAX_UNPACKED or min(*sizes, rows, 0) < 0:
        raise RacinesError(
            f"{where}: claims {rows:,} rows, {unpacked:,} bytes unpacked: at most "
            f"{MAX_ROWS:,} and {MAX_UNPACKED:,}"
        )
    if stated.num_row_groups > MAX_GROUPS:
        raise RacinesError(f"{where}: {stated.num_row_groups:,} row groups: at most {MAX_GROUPS:,}")


def check_safetensors(content: bytes, where: str) -> None:
    """Check a safetensors file: its header, and that the tensors fill the rest byte for byte."""
    length = int.from_bytes(content[:8], "little")
    if length > MAX_HEADER:
        raise RacinesError(f"{where}: a header of {length:,} bytes: at most {MAX_HEADER:,}")
    try:
        deserialize(content)
        # Of two tensors of one name the library takes the last.
        json.loads(content[8 : 8 + length], object_pairs_hook=_once)
    except (SafetensorError, ValueError, RecursionError) as error:
        raise RacinesError(f"{where}: not a sound safetensors file: {error}") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("a key stands twice")
    return dict(pairs)
