"""The folders and tables of CACTUS: which images there are, and what grade each has.

    Images Dataset/A4C/7_0123.jpg       the grade, then a name; perhaps in a folder of its own
    Grades/A4C_grades.csv               Image Name, Subfolder Name, Grade

Names of folders may differ in case.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from racines_data.errors import RacinesError
from racines_data.sources.folder import Report
from racines_data.sources.images import Kind
from racines_data.sources.release.tree import entries, natural
from racines_data.views import LABELS, RANDOM

IMAGES, GRADES = "Images Dataset", "Grades"
_COLUMNS = ("Image Name", "Subfolder Name", "Grade")
_GRADE = re.compile(r"(\d+(?:\.\d+)?)(?![\d.]*\d)")


@dataclass(frozen=True)
class Picture:
    """One image and what is known of it."""

    file: str
    """Relative to the folder of the data set."""
    view: str
    subfolder: str
    """Folder inside the view's, or nothing."""
    grade: float | None

    @property
    def order(self) -> tuple[list[tuple[int, str]], list[tuple[int, str]], str]:
        """Sort by folder and by the name without its grade: neighbours in time come together."""
        name = self.file.rpartition("/")[2]
        rest = _GRADE.sub("", name, count=1) if _GRADE.match(name) else name
        return natural(self.subfolder), natural(rest), name


def find_pictures(report: Report) -> list[Picture]:
    """Return all images of the report's folder with their grades; add what is odd to the report.

    Raises:
        RacinesError: the folder does not hold the data set, or a table cannot be read.
    """
    root = report.root
    images, grades = _child(root, IMAGES), _child(root, GRADES)
    if images is None:
        raise RacinesError(f"{root}: holds no folder `{IMAGES}`; give the folder that does")
    views = {view.lower(): view for view in LABELS}
    pictures: list[Picture] = []
    for folder in entries(images):
        view = views.get(folder.name.lower())
        if view is None or not folder.is_dir():
            report.flag(Kind.UNKNOWN, folder, "not a view of CACTUS, left out", frames=0)
            continue
        files = _images(folder, report)
        table = _Table.read(grades, view, report)
        pictures += [table.join(folder, file, report) for file in files]
        lost = [row for rows in table.rows.values() for row in rows if row not in table.used]
        for name, _, _ in lost:
            detail = f"there is no such image in {report.place(folder)}"
            report.refuse(Kind.MISSING_IMAGE, table.name, detail, name)
    if not pictures:
        raise RacinesError(f"{images}: holds no image of a view ({', '.join(LABELS)})")
    return pictures


def _child(folder: Path, name: str) -> Path | None:
    found = (path for path in entries(folder) if path.name.lower() == name.lower())
    return next((path for path in found if path.is_dir()), None)


def _images(folder: Path, report: Report) -> list[Path]:
    """Return the images of a view's folder and of the folders in it."""
    found: list[Path] = []
    for path in entries(folder):
        if path.is_dir():
            found += _images(path, report)
        elif path.suffix.lower() in (".jpg", ".jpeg"):
            found.append(path)
        else:
            report.flag(Kind.UNKNOWN, path, "not a JPEG by its name, left out", frames=0)
    if not found:
        report.refuse(Kind.EMPTY_FOLDER, folder, "it holds no image", frames=0)
    return found


@dataclass
class _Table:
    """The grades of one view by the image's name without its ending, lower case."""

    name: str
    view: str
    rows: dict[str, list[tuple[str, str, str]]] = field(default_factory=lambda: defaultdict(list))
    """Image name, subfolder and grade as they stand."""
    used: set[tuple[str, str, str]] = field(default_factory=set)

    @classmethod
    def read(cls, folder: Path | None, view: str, report: Report) -> "_Table":
        wanted = f"{view}_grades.csv"
        files = entries(folder) if folder else []
        path = next((file for file in files if file.name.lower() == wanted.lower()), None)
        if path is None:
            detail = "no such table; grades are those of the file names"
            report.flag(Kind.MISSING_TABLE, f"{GRADES}/{wanted}", detail, frames=0)
            return cls("", view)
        table = cls(f"{GRADES}/{path.name}", view)
        for row in _read_csv(path).iter_rows():
            name, subfolder, grade = ((cell or "").strip() for cell in row)
            table.rows[_key(name)].append((name, subfolder, grade))
        return table

    def join(self, folder: Path, path: Path, report: Report) -> Picture:
        """Return an image with the grade that its name and its row agree on."""
        inside = path.parent.relative_to(folder).as_posix()
        subfolder = "" if inside == "." else inside
        rows = self.rows.get(_key(path.name), [])
        if len(rows) > 1 and subfolder:
            rows = [row for row in rows if row[1].lower() == subfolder.lower()] or rows
        self.used.update(rows)
        match = _GRADE.match(path.name)
        said = {f"file name {match[1]}": _number(match[1])} if match else {}
        said |= {f"{self.name} {row[2]}": _number(row[2]) for row in rows}
        if self.name and not rows:
            detail = f"{self.name} has no row of it; its grade is that of its name"
            report.flag(Kind.MISSING_ROW, path, detail)
        grade, told = next(iter(said.values()), None), ", ".join(said)
        lowest, highest = (0, 0) if self.view == RANDOM else (1, 10)
        if len(set(said.values())) > 1:
            grade = None
            report.flag(Kind.GRADE_CONFLICT, path, f"{told}; it is kept without a grade", "Grade")
        elif said and (grade is None or not lowest <= grade <= highest):
            grade = None
            right = "0" if self.view == RANDOM else "1-10"
            detail = f"{told}, where {self.view} has {right}; it is kept without a grade"
            report.flag(Kind.WRONG_GRADE, path, detail, "Grade")
        return Picture(report.place(path), self.view, subfolder, grade)


def _read_csv(path: Path) -> pl.DataFrame:
    """Return the three columns as text."""
    try:
        table = pl.read_csv(path, infer_schema=False, encoding="utf8-lossy")
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RacinesError(f"{path}: not a CSV table: {error}") from error
    names = {name.strip().lower(): name for name in table.columns}
    missing = [name for name in _COLUMNS if name.lower() not in names]
    if missing:
        raise RacinesError(f"{path}: has no column {missing[0]!r}; it has {table.columns}")
    return table.select([names[name.lower()] for name in _COLUMNS])


def _key(name: str) -> str:
    return re.sub(r"\.jpe?g$", "", name.replace("\\", "/").rpartition("/")[2].lower())


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def runs(pictures: Sequence[Picture], longest: int) -> list[list[Picture]]:
    """Return contiguous runs of the images of one folder, in order, of nearly equal lengths."""
    ordered = sorted(pictures, key=lambda picture: picture.order)
    count = -(-len(ordered) // longest)
    edges = [len(ordered) * i // count for i in range(count + 1)]
    return [ordered[start:stop] for start, stop in zip(edges, edges[1:], strict=False)]
