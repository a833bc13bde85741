"""A submission: its YAML, read as what a stranger wrote, and the artefacts that it names.

The YAML is plain data, bounded, of one meaning only. Artefacts have plain names and are plain
files, bounded, no pickle under any name. A file is opened once, without following links, and all
that is said of it is said of that open file.
"""

import contextlib
import errno
import hashlib
import importlib.util
import math
import os
import re
import stat
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import yaml

from racines_data.errors import RacinesError
from racines_leaderboard.records.names import check_hash, check_unlike
from racines_leaderboard.records.schema import check

if TYPE_CHECKING:
    from _typeshed import SupportsRead

MAX_BYTES = 200 * 2**20
"""Largest artefact."""
MAX_YAML = 64 * 2**10
MAX_DEPTH = 12
CONTROLS = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Unicode categories that cannot be seen, or that turn the text around them."""
CHUNK = 2**20
_WISHED = ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY")  # Windows: the last alone
_FLAGS = sum((getattr(os, flag, 0) for flag in _WISHED), os.O_RDONLY)
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
"""Devices under Windows, whatever the ending."""
CONTAINERS = {bytes([0x80, protocol]): "a pickle" for protocol in range(1, 6)} | {
    b"PK\x03\x04": "a zip archive (torch.save writes pickles in one)",
    b"PK\x05\x06": "a zip archive",
    b"PK\x07\x08": "a zip archive",
    b"\x1f\x8b": "a gzip archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ\x00": "an xz archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x28\xb5\x2f\xfd": "a zstd archive",
    b"\x93NUMPY": "a NumPy file, which may hold pickles",
    b"\x89HDF": "an HDF5 file, which may hold pickles",
    b"\x7fELF": "a program",
    b"MZ": "a program",
    b"#!": "a script",
}
OLD_PICKLE = re.compile(rb"[(\]}]|c[\w.]+\n[\w.]+\n")
"""How pickles of protocol 0 and 1, which have no mark of their own, begin."""
SAFETENSORS = b"\x00\x00\x00\x00{"
"""Bytes 4 to 8 of a safetensors file. Those before are its header's length, which may be any."""
REMEDY = "a pickle can run code and an archive can unpack to anything: give " + (
    "safetensors, ONNX, Parquet or JSON"
)

GENERATORS, AGENTS, ON_PATIENTS = "generators", "agents", "patient-agents"
ADAPTING, TURNS = "patient-generators", "turn-generators"
MOVING = "motion", "tracked-motion", "turn-motion"
_STEER = AGENTS, ON_PATIENTS
ALL = (GENERATORS, *_STEER, ADAPTING, TURNS, *MOVING)
SEVERAL = {"generator": ALL, "motion": ALL, "policy": _STEER, "predictions": (ADAPTING,)}
"""Kinds of which there may be several, the trainings of one method, and where."""


@dataclass(frozen=True)
class Kind:
    """What a kind of artefact is."""

    suffix: str
    tracks: tuple[str, ...]
    told: str
    rescored: bool = False
    """Whether scores can be made of it without code of its maker."""


KINDS = {
    "predictions": Kind(".parquet", (GENERATORS, ADAPTING, TURNS), "images of test poses", True),
    "generator": Kind(".onnx", (GENERATORS, TURNS), "a network that draws", True),
    "policy": Kind(".onnx", _STEER, "a network that steers", True),
    "trace": Kind(".json", _STEER, "the actions of every episode", True),
    "motion": Kind(".parquet", MOVING, "the motion of every test sweep", True),
    "weights": Kind(".safetensors", ALL, "weights of merged code"),
    "scores": Kind(".json", ALL, "the submitter's own scores"),
    "robustness": Kind(".json", (ON_PATIENTS,), "the submitter's own robustness report"),
    "adapter": Kind("", ALL, "merged code"),
}
YAML = "submission.yaml"
BLANKS = (
    "YOUR NAME",
    "A FEW WORDS FOR THE TABLE",
    "A FEW SENTENCES.",
    "IMAGES OR STEPS SEEN",
    "WHAT IT RAN ON",
)
"""What stands in a template to be filled in."""
PACKAGES = ("racines_data", "racines_models", "racines_envs", "racines_leaderboard")
GROUPS = ("racines.generators", "racines.agents", "racines.motions")


def files_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the artefacts that are files."""
    return [each for each in document["artefacts"] if each["kind"] != "adapter"]


def rescored(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the artefacts that scores are made of again; all of one kind."""
    return [each for each in document["artefacts"] if KINDS[each["kind"]].rescored]


def check_artefacts(document: dict[str, Any], where: str) -> None:
    """Check kinds, names and adapters of a document that fits the schema; nothing is opened.

    Raises:
        RacinesError: a kind of the other track, a name that is no bare file name or stands twice,
            another ending than the kind's, a digest that is made up or stands twice, an adapter
            that is not merged, no plain choice of what is scored, or a tier that cannot be reached.
    """
    seen, held = {YAML}, dict[str, str]()
    for i, artefact in enumerate(document["artefacts"]):
        field, kind = f"{where}: artefacts.{i}", KINDS[artefact["kind"]]
        if document["track"] not in kind.tracks:
            raise RacinesError(f"{field}.kind: {artefact['kind']} is none of {document['track']}")
        content = artefact.get("sha256") or artefact["adapter"]
        if "adapter" in artefact:
            _check_adapter(content, f"{field}.adapter")
        else:
            name = check_name(artefact["path"], f"{field}.path")
            if Path(name).suffix != kind.suffix:
                raise RacinesError(
                    f"{field}.path: {name!r} refused: {artefact['kind']} is a {kind.suffix} file"
                )
            if name.casefold() in seen:
                raise RacinesError(f"{field}.path: {name!r} stands twice: one entry a file")
            seen.add(name.casefold())
            check_hash(content, f"{field}.sha256")
        if content in held:
            raise RacinesError(f"{field}: the same as {held[content]}: one entry an artefact")
        held[content] = f"artefacts.{i}"
    # A robustness report says itself in which world it was made, and one submission may have two.
    made = [each for each in files_of(document) if each["kind"] != "robustness"]
    if made and "digest" not in document["dataset"]:
        raise RacinesError(f"{where}: dataset.digest: missing: give the data's, or its recipe's")
    kinds = [each["kind"] for each in rescored(document)]
    several = len(kinds) > 1 and document["track"] not in SEVERAL.get(kinds[0], ())
    if {"trace", "robustness"} <= {each["kind"] for each in document["artefacts"]}:
        raise RacinesError(f"{where}: artefacts: a trace looks at nothing: leave robustness out")
    if len(set(kinds)) > 1 or several:
        raise RacinesError(
            f"{where}: artefacts: {', '.join(kinds)}: give one that is scored again; several only "
            "of generators, policies, motions, predictions of patients: a method's seeds"
        )
    merged, tier = any("adapter" in each for each in document["artefacts"]), document["tier"]
    if tier == "recomputed" and not kinds:
        needs = "predictions, a generator, a policy, a trace or motions"
        raise RacinesError(f"{where}: tier: {tier} needs {needs}")
    if tier == "reproduced" and not merged:
        raise RacinesError(f"{where}: tier: {tier} needs merged code, an adapter")


def _check_filled_in(document: dict[str, Any], where: str) -> None:
    """Refuse what a template left to be filled in, and authors that look alike."""
    authors = document["authors"]
    told = {"method": document["method"], "description": document["description"].strip()}
    told |= {f"training.{key}": value for key, value in document["training"].items()}
    told |= {f"authors.{i}": name for i, name in enumerate(authors)}
    if blank := [f"{field}: {value!r}" for field, value in told.items() if value in BLANKS]:
        raise RacinesError(f"{where}: {'; '.join(blank)}: fill them in")
    for i, name in enumerate(authors):
        check_unlike(name, authors[:i], f"{where}: authors.{i}")
    if "digest" in document["dataset"]:
        check_hash(document["dataset"]["digest"], f"{where}: dataset.digest")
    if len(set(commit := document["code"].get("commit", "ab"))) == 1:
        raise RacinesError(f"{where}: code.commit: {commit!r} is a placeholder: name the commit")


def _check_adapter(target: str, where: str) -> None:
    """Check that `module:Class` is code of this repository; nothing of it is imported."""
    with contextlib.suppress(PackageNotFoundError):
        points = distribution("racines").entry_points
        if target in {point.value for point in points if point.group in GROUPS}:
            return
    module = target.partition(":")[0].split(".")
    if module[0] not in PACKAGES:
        raise RacinesError(
            f"{where}: {target!r} refused: only merged code is run; give a class of "
            f"{', '.join(PACKAGES)}, or predictions, an ONNX file or a trace"
        )
    spec = importlib.util.find_spec(module[0])
    root = Path(spec.origin).parent if spec and spec.origin else Path()
    file = root.joinpath(*module[1:])
    if not (file.with_suffix(".py").is_file() or (file / "__init__.py").is_file()):
        raise RacinesError(f"{where}: {target!r}: no such module in {module[0]}")


def check_name(name: object, where: str) -> str:
    """Return the name of a file; refuse one that is a path, hidden, overlong or reserved."""
    if not isinstance(name, str) or not NAME.fullmatch(name) or RESERVED.fullmatch(name):
        raise RacinesError(
            f"{where}: {str(name)[:120]!r} refused: give the bare name of a file in the "
            "submission's folder, 1 to 100 of A-Z a-z 0-9 . _ -, the first a letter or digit"
        )
    return name


@contextlib.contextmanager
def opened(folder: Path, name: str, where: str, limit: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """Open a regular file of a folder, no link, device or folder, of 1 to `limit` bytes."""
    if os.name == "nt" and (folder / name).is_symlink():  # no flag says so
        raise RacinesError(f"{where}: {name}: a symbolic link: put the file itself there")
    try:
        handle = os.open(folder / name, _FLAGS)
    except FileNotFoundError as error:
        raise RacinesError(f"{where}: {name}: no such file beside the submission") from error
    except OSError as error:
        link = error.errno == errno.ELOOP
        reason = "a symbolic link: put the file itself there" if link else error.strerror
        raise RacinesError(f"{where}: {name}: {reason}") from error
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise RacinesError(f"{where}: {name}: no regular file: put the file itself there")
    with os.fdopen(handle, "rb") as stream:
        if not 1 <= status.st_size <= limit:
            raise RacinesError(
                f"{where}: {name}: {status.st_size:,} bytes: give a file of 1 to {limit:,}"
            )
        yield stream


def read_bounded(folder: Path, name: str, where: str, limit: int) -> bytes:
    """Return the bytes of a file `opened`, at most `limit` even if it grows meanwhile."""
    with opened(folder, name, where, limit) as stream:
        content = stream.read(limit + 1)
    if len(content) > limit:
        raise RacinesError(f"{where}: {name}: more than {limit:,} bytes")
    return content


def measure(
    stream: "SupportsRead[bytes]", where: str, out: BinaryIO | None = None
) -> tuple[str, int]:
    """Return the sha256 and the size of a stream, copied into `out` on the way.

    One longer than MAX_BYTES is refused, and one that begins as a pickle or an archive does.
    """
    digest, size = hashlib.sha256(), 0
    while chunk := stream.read(CHUNK):
        if not size:
            _check_head(chunk[:512], where)
        size += len(chunk)
        if size > MAX_BYTES:
            raise RacinesError(f"{where}: more than {MAX_BYTES:,} bytes: give a smaller file")
        digest.update(chunk)
        if out is not None:
            out.write(chunk)
    return digest.hexdigest(), size


def _check_head(head: bytes, where: str) -> None:
    """Refuse what runs code or unpacks, by its first bytes and whatever its name."""
    if head[4:9] == SAFETENSORS:
        return
    found = [what for mark, what in CONTAINERS.items() if head.startswith(mark)]
    if head[257:262] == b"ustar":
        found.append("a tar archive")
    if OLD_PICKLE.match(head):
        found.append("a pickle")
    if found:
        raise RacinesError(f"{where} holds {found[0]}: refused; {REMEDY}")


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
        if not unicodedata.is_normalized("NFC", value):
            raise RacinesError(f"{where}: {value[:80]!r} is not in Unicode's form NFC: write it so")
    elif isinstance(value, float) and not math.isfinite(value):
        raise RacinesError(f"{where}: {value}: give a finite number, or leave it out")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise RacinesError(f"{where}: a number beyond 64 bits")


def read_document(path: Path) -> dict[str, Any]:
    """Read and check a submission's YAML, not the files that it names.

    Refused: more than 64 KiB or than plain data, a faulty field, an artefact that may not be.
    """
    content = read_bounded(path.parent, path.name, str(path.parent), MAX_YAML)
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
    _check_filled_in(document, str(path))
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
