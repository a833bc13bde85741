"""The published recordings on the disk: their folders, and the log beside each image.

    Folder 1/A4C/images/img<N>.png      Folder 1/A4C/logs/PA_<N>.txt
    Folder 1/SC/images_2/…              Folder 1/SC/logs_2/…
    Folder 3/Full/1/images/…            Folder 3/Full/1/logs/…

A folder is a session, an image folder a trajectory, `Full` a random scan. A log is a text:

    Time: 12.34
    Force and Torque: [[-0.06000000]
     ...                                six rows: fx fy fz tx ty tz, N and N·m
     [ 0.06500000]]
    Pose Matrix (ROT):
    [[ 1.00000000  0.00000000  0.00000000  0.48860000]
     ...                                rotation and position, m, robot base frame
     [ 0.00000000  0.00000000  0.00000000  1.00000000]]
    Control Effort (CO): [vx vy vz wx wy wz]

Arrays stand as NumPy prints them. Commas are read as well, and a column where a row is usual.
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.folder import Report
from racines_data.sources.images import Fault, Kind
from racines_data.sources.table.inputs import open_folder
from racines_data.views import RANDOM

FULL = "Full"
RIGHTS = "RIGHTS.txt"
"""Licence, consent and origin, at the top of an exported tree; no part of the recordings."""
_MOST_GAPS = 20
_SESSION = re.compile(r"folder[ _-]?(\d+)", re.IGNORECASE)
_SIDE = re.compile(r"(images|logs)(?:_(\d+))?", re.IGNORECASE)
_IMAGE = re.compile(r"img(\d+)\.png", re.IGNORECASE)
_LOG = re.compile(r"PA_(\d+)\.txt", re.IGNORECASE)
_JUNK = re.compile(
    r"\.DS_Store|Thumbs\.db|desktop\.ini|__MACOSX|\._.*|\.git.*|\.dvc.*|.*\.dvc|\.dvcignore",
    re.IGNORECASE,
)
TIME, WRENCH, POSE, CONTROL = 0, slice(1, 7), slice(7, 23), slice(23, 29)
"""Columns of a log as one row of 29 numbers; the pose is a 4×4 matrix, row by row."""
WIDTH = 29
FIELDS = ("Time", "Force and Torque", "Pose Matrix (ROT)", "Control Effort (CO)")
_HEADINGS = re.compile(r"^[ \t]*(" + "|".join(map(re.escape, FIELDS)) + r"):", re.MULTILINE)
_DIGITS = 8


class SweepFolder(NamedTuple):
    """One image folder and its logs."""

    id: str
    session: str
    target_view: str
    images: Path
    logs: Path


class Pair(NamedTuple):
    """One frame: its number and the names of its two files."""

    number: int
    image: str
    log: str


def natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts 2 before 10."""
    words = re.split(r"(\d+)", name.lower())
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in words]


def entries(folder: Path) -> list[Path]:
    """Return what a folder holds, in natural order, without the litter of operating systems."""
    found = (path for path in folder.iterdir() if not _JUNK.fullmatch(path.name))
    return sorted(found, key=lambda path: natural(path.name))


def find_recordings(views: Sequence[str], report: Report) -> list[SweepFolder]:
    """Return the image folders of a release in order; add what is odd about folders to `report`.

    Raises:
        RacinesError: no session folder is there, or two folders stand for one trajectory.
    """
    root = report.root
    names = {view.lower(): view for view in views} | {FULL.lower(): RANDOM}
    named = [path for path in entries(root) if path.name != RIGHTS]
    sessions = {path: _SESSION.fullmatch(path.name) for path in named}
    if not any(sessions.values()):
        raise RacinesError(f"{root}: holds no `Folder 1`, `Folder 2` …{_nearby(root)}")
    recordings: list[SweepFolder] = []
    _flag_unknown(root, [path for path, match in sessions.items() if not match], report)
    for folder, match in sessions.items():
        if match is None or not folder.is_dir():
            continue
        inside = {path: names.get(path.name.lower()) for path in entries(folder)}
        _flag_unknown(folder, [path for path, view in inside.items() if not view], report)
        if not any(inside.values()):
            _refuse_empty(folder, report)
        for path, view in inside.items():
            if view and path.is_dir():
                session = f"folder-{int(match[1])}"
                name = f"{session}-{path.name.lower()}"
                recordings += _view_recordings(path, name, session, view, report)
    seen: dict[str, str] = {}
    for recording in recordings:
        where = report.place(recording.images)
        if seen.setdefault(recording.id, where) != where:
            raise RacinesError(
                f"{where} and {seen[recording.id]} both stand for {recording.id}: rename one"
            )
    return recordings


def _nearby(root: Path) -> str:
    for path in entries(root):
        if path.is_dir() and any(_SESSION.fullmatch(inner.name) for inner in entries(path)):
            return f"; give {path}"
    return "; give the folder that holds them"


def _view_recordings(
    folder: Path, name: str, session: str, view: str, report: Report
) -> Iterator[SweepFolder]:
    """Yield the recordings of a view's folder: `images`, `images_2` …, then `1/images` …."""
    sides: dict[tuple[str, str], Path] = {}
    unknown: list[Path] = []
    parts: list[Path] = []
    for path in entries(folder):
        match = _SIDE.fullmatch(path.name)
        if match and path.is_dir():
            sides[match[1].lower(), match[2] or ""] = path
        elif path.name.isdecimal() and path.is_dir():
            parts.append(path)
        else:
            unknown.append(path)
    _flag_unknown(folder, unknown, report)
    if not sides and not parts:
        _refuse_empty(folder, report)
    for number in sorted({number for _, number in sides}, key=natural):
        images, logs = (sides.get((side, number)) for side in ("images", "logs"))
        if images and logs:
            whole = f"{name}-{int(number)}" if number else name
            yield SweepFolder(whole, session, view, images, logs)
        elif images:
            _refuse_lonely(Kind.MISSING_LOG, images, _IMAGE, ("images", "logs"), report)
        elif logs:
            _refuse_lonely(Kind.MISSING_IMAGE, logs, _LOG, ("logs", "images"), report)
    for part in parts:
        yield from _view_recordings(part, f"{name}-part{int(part.name)}", session, view, report)


def _refuse_lonely(
    kind: Kind, folder: Path, pattern: re.Pattern[str], sides: tuple[str, str], report: Report
) -> None:
    """Report a whole folder of images without logs, or of logs without images."""
    count = sum(bool(pattern.fullmatch(path.name)) for path in entries(folder))
    if count:
        detail = f"there is no folder {folder.name.lower().replace(*sides)} beside it, for {count}"
        report.refuse(kind, folder, f"{detail} frames", frames=count)
    else:
        _refuse_empty(folder, report)


def pair_files(recording: SweepFolder, report: Report) -> list[Pair]:
    """Return the frames of a recording in order of their numbers; add the others to `report`.

    Two files of one number and equal bytes count as one; if they differ, neither is used. Numbers
    that are skipped are flagged.
    """
    images = _numbered(recording.images, _IMAGE, report)
    logs = _numbered(recording.logs, _LOG, report)
    numbers = sorted({*images, *logs})
    pairs: list[Pair] = []
    for number in numbers:
        image = _single(number, images.get(number, []), report)
        log = _single(number, logs.get(number, []), report)
        if number not in logs:
            detail = f"there is no {recording.logs.name}/PA_{number}.txt"
            report.refuse(Kind.MISSING_LOG, images[number][0], detail)
        elif number not in images:
            detail = f"there is no {recording.images.name}/img{number}.png"
            report.refuse(Kind.MISSING_IMAGE, logs[number][0], detail)
        elif image and log:
            pairs.append(Pair(number, image.name, log.name))
    if not numbers:
        _refuse_empty(recording.images, report)
    _flag_gaps(recording.images, numbers, report)
    return pairs


def _numbered(folder: Path, pattern: re.Pattern[str], report: Report) -> dict[int, list[Path]]:
    """Return the files of each number, the one named without leading zeros first."""
    numbered: dict[int, list[Path]] = defaultdict(list)
    unknown: list[Path] = []
    for path in entries(folder):
        match = pattern.fullmatch(path.name)
        (numbered[int(match[1])] if match else unknown).append(path)
    _flag_unknown(folder, unknown, report)
    for paths in numbered.values():
        paths.sort(key=lambda path: (len(path.name), path.name))
    return numbered


def _single(number: int, paths: Sequence[Path], report: Report) -> Path | None:
    if len(paths) < 2:
        return paths[0] if paths else None
    names = " and ".join(path.name for path in paths)
    folder = open_folder(report.root)
    sound = not any(folder.fault(path) for path in paths)  # else none of them is opened
    equal = sound and len({path.read_bytes() for path in paths}) == 1
    verdict = "are equal, one is used" if equal else "differ, none is used"
    for path in paths[1:] if equal else paths:
        detail = f"{names} all have number {number}; they {verdict}"
        frames = int(not equal and path is paths[0])
        report.refuse(Kind.DUPLICATE_NUMBER, path, detail, frames=frames)
    return paths[0] if equal else None


def _flag_gaps(folder: Path, numbers: Sequence[int], report: Report) -> None:
    """Flag each run of numbers that is skipped between the first and the last."""
    jumps = [(one, two) for one, two in pairwise(numbers) if two - one > 1]
    if len(jumps) > _MOST_GAPS:
        skipped = sum(two - one - 1 for one, two in jumps)
        detail = f"{skipped} numbers are skipped in {len(jumps)} places; the others are kept"
        report.flag(Kind.GAP, folder, detail, frames=0)
        return
    for one, two in jumps:
        skipped = f"{one + 1}" if two - one == 2 else f"{one + 1}-{two - 1}"
        detail = f"no frame has number {skipped}; the others are kept"
        report.flag(Kind.GAP, folder, detail, skipped, frames=0)


def _refuse_empty(folder: Path, report: Report) -> None:
    report.refuse(Kind.EMPTY_FOLDER, folder, "it holds no frame", frames=0)


def _flag_unknown(folder: Path, paths: Sequence[Path], report: Report) -> None:
    if paths:
        names = ", ".join(path.name for path in paths[:3])
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        detail = f"{names}{more}: not of the published layout, left out"
        report.flag(Kind.UNKNOWN, folder, detail, frames=0)


def parse_log(text: str) -> list[float]:
    """Return the 29 numbers of a log: time, wrench, pose matrix, control effort, as they stand.

    Raises:
        Fault: a field is missing or stands twice, is not numbers, or has the wrong shape.
    """
    parts = _HEADINGS.split(text)
    fields = dict(zip(parts[1::2], parts[2::2], strict=True))
    for name in FIELDS:
        if name not in fields:
            raise Fault(Kind.UNREADABLE_LOG, "the field is missing", name)
    if len(parts) > 2 * len(FIELDS) + 1:
        raise Fault(Kind.UNREADABLE_LOG, "a field stands twice")
    time = _rows(FIELDS[0], fields[FIELDS[0]])
    if [len(row) for row in time] != [1]:
        detail = f"{fields[FIELDS[0]].strip()!r} is not seconds"
        raise Fault(Kind.UNREADABLE_LOG, detail, FIELDS[0])
    six, four = ([6], [1] * 6), ([4] * 4,)
    pose = _array_of(FIELDS[2], fields, four, "4×4")
    wrench = _array_of(FIELDS[1], fields, six, "six")
    return [*time[0], *wrench, *pose, *_array_of(FIELDS[3], fields, six, "six")]


def _array_of(
    name: str, fields: Mapping[str, str], shapes: Sequence[list[int]], wanted: str
) -> list[float]:
    """Return the numbers of a field whose rows have the lengths of one of the shapes."""
    rows = _rows(name, fields[name])
    lengths = [len(row) for row in rows]
    if lengths not in shapes:
        width = "/".join(map(str, sorted(set(lengths)))) or 0
        detail = f"{len(rows)}×{width} numbers instead of {wanted}"
        raise Fault(Kind.WRONG_SHAPE, detail, name)
    return [number for row in rows for number in row]


def _rows(name: str, text: str) -> list[list[float]]:
    rows = text.replace(",", " ").replace("[", " ").split("]")
    try:
        return [row for row in ([float(word) for word in row.split()] for row in rows) if row]
    except ValueError as error:
        raise Fault(Kind.UNREADABLE_LOG, f"{error}", name) from error


def format_log(row: np.ndarray) -> str:
    """Return the text of a log from (29,) numbers; absent ones are printed as nan.

    Numbers are printed as NumPy does with eight fixed decimals: 1e-8 m, rad, N. The control effort
    stands on one line, as readers expect that match it line by line.
    """
    time = np.format_float_positional(row[TIME], unique=True, trim="0")
    wrench, pose = _printed(row[WRENCH], 1), _printed(row[POSE], 4)
    return (
        f"Time: {time}\nForce and Torque: {wrench}\nPose Matrix (ROT):\n{pose}\n"
        f"Control Effort (CO): {_printed(row[CONTROL], 6)[1:-1]}\n"
    )


def _printed(values: np.ndarray, columns: int) -> str:
    """Print numbers in rows as NumPy does; its own printer takes fifty times as long."""
    # The sum turns a negative zero into zero.
    words = [f"{number + 0.0:.{_DIGITS}f}" for number in values.round(_DIGITS).tolist()]
    width = max(map(len, words))
    rows = (words[start : start + columns] for start in range(0, len(words), columns))
    return "[" + "\n ".join(f"[{' '.join(w.rjust(width) for w in row)}]" for row in rows) + "]"
