"""The folders of the published recordings: which hold images, and which image has which log.

    Folder 1/A4C/images/img<N>.png      Folder 1/A4C/logs/PA_<N>.txt
    Folder 1/SC/images_2/…              Folder 1/SC/logs_2/…
    Folder 3/Full/1/images/…            Folder 3/Full/1/logs/…

A folder is a session, an image folder a trajectory, `Full` a random scan.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.sources.base import Finding
from racines_data.sources.release.kinds import Kind, flagged, refused
from racines_data.views import RANDOM

FULL = "Full"
_MOST_GAPS = 20
_SESSION = re.compile(r"folder[ _-]?(\d+)", re.IGNORECASE)
_SIDE = re.compile(r"(images|logs)(?:_(\d+))?", re.IGNORECASE)
_IMAGE = re.compile(r"img(\d+)\.png", re.IGNORECASE)
_LOG = re.compile(r"PA_(\d+)\.txt", re.IGNORECASE)
_JUNK = re.compile(
    r"\.DS_Store|Thumbs\.db|desktop\.ini|__MACOSX|\._.*|\.git.*|\.dvc.*|.*\.dvc|\.dvcignore",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class SweepFolder:
    """One image folder and its logs."""

    id: str
    session: str
    target_view: str
    images: Path
    logs: Path
    where: str
    """The image folder, relative to the release."""


@dataclass(frozen=True)
class Pair:
    """One frame: its number and the names of its two files."""

    number: int
    image: str
    log: str


def natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts 2 before 10."""
    words = re.split(r"(\d+)", name.lower())
    return [(int(word), "") if word.isdigit() else (-1, word) for word in words]


def entries(folder: Path) -> list[Path]:
    """Return what a folder holds, in natural order, without the litter of operating systems."""
    found = (path for path in folder.iterdir() if not _JUNK.fullmatch(path.name))
    return sorted(found, key=lambda path: natural(path.name))


def find_recordings(root: Path, views: Sequence[str], report: list[Finding]) -> list[SweepFolder]:
    """Return the image folders of a release in order; add what is odd about folders to `report`.

    Raises:
        RacinesError: no session folder is there, or two folders stand for one trajectory.
    """
    names = {view.lower(): view for view in views} | {FULL.lower(): RANDOM}
    sessions = {path: _SESSION.fullmatch(path.name) for path in entries(root)}
    if not any(sessions.values()):
        raise RacinesError(f"{root}: holds no `Folder 1`, `Folder 2` …{_nearby(root)}")
    recordings: list[SweepFolder] = []
    _flag_unknown(root, root, [path for path, match in sessions.items() if not match], report)
    for folder, match in sessions.items():
        if match is None or not folder.is_dir():
            continue
        inside = {path: names.get(path.name.lower()) for path in entries(folder)}
        _flag_unknown(root, folder, [path for path, view in inside.items() if not view], report)
        if not any(inside.values()):
            _report_empty(root, folder, report)
        for path, view in inside.items():
            if view and path.is_dir():
                session = f"folder-{int(match[1])}"
                name = f"{session}-{path.name.lower()}"
                recordings += _view_recordings(root, path, (name, session, view), report)
    _check_names(recordings)
    return recordings


def _nearby(root: Path) -> str:
    for path in entries(root):
        if path.is_dir() and any(_SESSION.fullmatch(inner.name) for inner in entries(path)):
            return f"; give {path}"
    return "; give the folder that holds them"


def _check_names(recordings: Sequence[SweepFolder]) -> None:
    seen: dict[str, str] = {}
    for recording in recordings:
        if seen.setdefault(recording.id, recording.where) != recording.where:
            raise RacinesError(
                f"{recording.where} and {seen[recording.id]} both stand for {recording.id}: "
                "rename one"
            )


def _view_recordings(
    root: Path, folder: Path, names: tuple[str, str, str], report: list[Finding]
) -> Iterator[SweepFolder]:
    """Yield the recordings of a view's folder: `images`, `images_2` …, then `1/images` …."""
    name, session, view = names
    sides: dict[tuple[str, str], Path] = {}
    unknown: list[Path] = []
    parts: list[Path] = []
    for path in entries(folder):
        match = _SIDE.fullmatch(path.name)
        if match and path.is_dir():
            sides[match[1].lower(), match[2] or ""] = path
        elif path.name.isdigit() and path.is_dir():
            parts.append(path)
        else:
            unknown.append(path)
    _flag_unknown(root, folder, unknown, report)
    if not sides and not parts:
        _report_empty(root, folder, report)
    for number in sorted({number for _, number in sides}, key=natural):
        images, logs = (sides.get((side, number)) for side in ("images", "logs"))
        suffix = f"-{int(number)}" if number else ""
        if images is None or logs is None:
            report += _one_sided(root, images, logs)
        else:
            yield SweepFolder(f"{name}{suffix}", session, view, images, logs, _place(root, images))
    for part in parts:
        inner = f"{name}-part{int(part.name)}"
        yield from _view_recordings(root, part, (inner, session, view), report)


def _one_sided(root: Path, images: Path | None, logs: Path | None) -> list[Finding]:
    """Report a whole folder of images without logs, or of logs without images."""
    folder = images or logs
    assert folder is not None
    kind, pattern = (Kind.MISSING_LOG, _IMAGE) if images else (Kind.MISSING_IMAGE, _LOG)
    other = folder.name.lower()
    other = other.replace("images", "logs") if images else other.replace("logs", "images")
    count = sum(bool(pattern.fullmatch(path.name)) for path in entries(folder))
    if not count:
        return [refused(Kind.EMPTY_FOLDER, _place(root, folder), "it holds no frame", frames=0)]
    detail = f"there is no folder {other} beside it, for {count} frames"
    return [refused(kind, _place(root, folder), detail, frames=count)]


def pair_files(root: Path, recording: SweepFolder, report: list[Finding]) -> list[Pair]:
    """Return the frames of a recording in order of their numbers; add the others to `report`.

    Two files of one number and equal bytes count as one; if they differ, neither is used. Numbers
    that are skipped are flagged.
    """
    images = _numbered(root, recording.images, _IMAGE, report)
    logs = _numbered(root, recording.logs, _LOG, report)
    pairs: list[Pair] = []
    for number in sorted(images.keys() | logs.keys()):
        image = _single(root, recording.images, number, images.get(number, []), report)
        log = _single(root, recording.logs, number, logs.get(number, []), report)
        if number not in logs:
            file = f"{recording.where}/{images[number][0].name}"
            wanted = f"{recording.logs.name}/PA_{number}.txt"
            report.append(refused(Kind.MISSING_LOG, file, f"there is no {wanted}"))
        elif number not in images:
            file = f"{_place(root, recording.logs)}/{logs[number][0].name}"
            wanted = f"{recording.images.name}/img{number}.png"
            report.append(refused(Kind.MISSING_IMAGE, file, f"there is no {wanted}"))
        elif image and log:
            pairs.append(Pair(number, image.name, log.name))
    if not images and not logs:
        _report_empty(root, recording.images, report)
    report += _gaps(recording, sorted(images.keys() | logs.keys()))
    return pairs


def _numbered(
    root: Path, folder: Path, pattern: re.Pattern[str], report: list[Finding]
) -> dict[int, list[Path]]:
    """Return the files of each number, the one named without leading zeros first."""
    numbered: dict[int, list[Path]] = {}
    unknown: list[Path] = []
    for path in entries(folder):
        match = pattern.fullmatch(path.name)
        if match:
            numbered.setdefault(int(match[1]), []).append(path)
        else:
            unknown.append(path)
    _flag_unknown(root, folder, unknown, report)
    return {number: sorted(paths, key=_plainness) for number, paths in numbered.items()}


def _plainness(path: Path) -> tuple[int, str]:
    return len(path.name), path.name


def _single(
    root: Path, folder: Path, number: int, paths: Sequence[Path], report: list[Finding]
) -> Path | None:
    if len(paths) < 2:
        return paths[0] if paths else None
    names = " and ".join(path.name for path in paths)
    equal = len({path.read_bytes() for path in paths}) == 1
    for path in paths[1:] if equal else paths:
        verdict = "are equal, one is used" if equal else "differ, none is used"
        detail = f"{names} all have number {number}; they {verdict}"
        frames = int(not equal and path is paths[0])
        file = f"{_place(root, folder)}/{path.name}"
        report.append(refused(Kind.DUPLICATE_NUMBER, file, detail, frames=frames))
    return paths[0] if equal else None


def _gaps(recording: SweepFolder, numbers: Sequence[int]) -> list[Finding]:
    """Flag each run of numbers that is skipped between the first and the last."""
    jumps = [(one, two) for one, two in pairwise(numbers) if two - one > 1]
    if len(jumps) > _MOST_GAPS:
        skipped = sum(two - one - 1 for one, two in jumps)
        detail = f"{skipped} numbers are skipped in {len(jumps)} places; the others are kept"
        return [flagged(Kind.GAP, recording.where, detail, frames=0)]
    found = []
    for one, two in jumps:
        skipped = f"{one + 1}" if two - one == 2 else f"{one + 1}-{two - 1}"
        detail = f"no frame has number {skipped}; the others are kept"
        found.append(flagged(Kind.GAP, recording.where, detail, skipped, frames=0))
    return found


def _report_empty(root: Path, folder: Path, report: list[Finding]) -> None:
    report.append(refused(Kind.EMPTY_FOLDER, _place(root, folder), "it holds no frame", frames=0))


def _flag_unknown(root: Path, folder: Path, paths: Sequence[Path], report: list[Finding]) -> None:
    if paths:
        names = ", ".join(path.name for path in paths[:3])
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        detail = f"{names}{more}: not of the published layout, left out"
        report.append(flagged(Kind.UNKNOWN, _place(root, folder), detail, frames=0))


def _place(root: Path, path: Path) -> str:
    return path.relative_to(root).as_posix()
