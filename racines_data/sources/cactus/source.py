"""CACTUS: graded images of the same phantom from a hand-held probe, without poses.

CC BY 4.0, DOI 10.20383/103.01484; 37,736 images. The files do not say which images belong to one
sweep. Images of one folder in order of their names are cut into contiguous runs, which stand as
trajectories: neighbours stay in one split but for those on both sides of a cut.
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np
import polars as pl
from scipy import ndimage

from racines_data.errors import RacinesError
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import SourceCard, Unit
from racines_data.sources.folder import FolderSource, Report, recorded
from racines_data.sources.images import Fault, Kind, check_jpeg, read_gray, resolution, square
from racines_data.sources.release.layout import entries, natural
from racines_data.sources.table.inputs import open_folder
from racines_data.views import LABELS, RANDOM

IMAGES, GRADES = "Images Dataset", "Grades"
_COLUMNS = ("Image Name", "Subfolder Name", "Grade")
_GRADE = re.compile(r"(\d+(?:\.\d+)?)(?![\d.]*\d)")
_THREADS = 4
_SAMPLE = 96
_MOVES = 4.0
"""Standard deviation over images above which a pixel belongs to the sector, gray levels."""
_DARK = 8
_FEWEST = 8
_SMALLEST = 0.02
Size = tuple[int, int]
Box = tuple[int, int, int, int]
"""Left, top, right, bottom: pixels, the last two past the end."""


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
        open_folder(report.root).file(report.place(path), "grades")
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
        lowest, highest, right = (0, 0, "0") if self.view == RANDOM else (1, 10, "1-10")
        if len(set(said.values())) > 1:
            grade = None
            report.flag(Kind.GRADE_CONFLICT, path, f"{told}; it is kept without a grade", "Grade")
        elif said and (grade is None or not lowest <= grade <= highest):
            grade = None
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


CARD = SourceCard(
    origin="the published CACTUS images, imported; labels and grades without poses",
    license="cc-by-4.0",
    rights="CC BY 4.0, as the originals (DOI 10.20383/103.01484); cite their authors.",
    collection="The published CACTUS images, imported: frames of a cardiac phantom with view and "
    "grade, without poses.",
    collection_type="Direct measurement",
    annotation="View and grade as published with the images; see the CACTUS publication.",
    biases="A manufactured heart; classes and grades in the shares its authors chose.",
    limitations="A phantom is not a patient. There are no poses or forces.",
    personal="None: images of a manufactured phantom.",
    limits="A manufactured phantom, not a patient. There are no poses, forces or times; runs of "
    "files stand as trajectories, and frames on both sides of a cut may be neighbours.",
    attribution="The authors of CACTUS, https://doi.org/10.20383/103.01484",
)


@dataclass(frozen=True)
class CactusConfig:
    """How CACTUS is read."""

    crop: str = "auto"
    """Part of the screen to keep: `auto` finds the sector, `none` keeps all, or left,top,right,
    bottom in pixels. One crop for all images of a size, so that it does not tell the view."""
    run: int = 250
    """Most images of a run that stands as a trajectory."""


@dataclass(frozen=True)
class CactusUnit(Unit):
    """One run of images."""

    root: Path
    pictures: tuple[Picture, ...]
    boxes: tuple[tuple[Size, Box], ...]
    """Crop of each image size."""


@dataclass
class CactusSource(FolderSource):
    """Reads the folder of CACTUS."""

    config: CactusConfig
    name = "cactus"
    version = "1.0.0"
    poses = False
    Config = CactusConfig
    card = CARD

    @classmethod
    def check_settings(cls, settings: CactusConfig) -> None:
        """Refuse a crop that is none, and runs of nothing."""
        if settings.crop not in ("auto", "none"):
            _fixed_box(settings.crop)
        if settings.run < 1:
            raise RacinesError("data.cactus.run: give one or more")

    def plan(self) -> list[CactusUnit]:
        """Check every file, join the grades, find the crop, and cut the folders into runs.

        Raises:
            RacinesError: the folder is not CACTUS, or the crop does not fit its images.
        """
        self.report = report = Report(self.root)
        found = find_pictures(report)
        digest = hashlib.sha256()
        kept: list[Picture] = []
        sizes: dict[Size, list[Picture]] = defaultdict(list)
        with ThreadPoolExecutor(_THREADS) as pool, progress_bar(self.progress) as bar:
            checks = pool.map(self._check, found)
            steps = bar.track(checks, total=len(found), description="checking images")
            for picture, (checked, sha256) in zip(found, steps, strict=True):
                digest.update(f"{picture.file}\0{picture.grade}\0".encode() + sha256)
                if isinstance(checked, Fault):
                    report.refuse(checked.kind, picture.file, checked.detail)
                    continue
                kept.append(picture)
                sizes[checked].append(picture)
        self._inputs = digest.hexdigest()
        usual = max(sizes, key=lambda size: (len(sizes[size]), size), default=(0, 0))
        for size, of in sorted(sizes.items()):
            if size != usual:
                detail = f"{resolution(size)}, most are {resolution(usual)}; cropped by itself"
                report.flag(Kind.MIXED_SIZES, of[0].file, detail, frames=len(of))
        boxes = tuple((size, self._box(size, of)) for size, of in sorted(sizes.items()))
        return list(self._units(kept, boxes))

    def produce(self, unit: Unit) -> Trajectory:
        """Read a run: cropped 128×128 gray images, views and grades; no poses, no times."""
        assert isinstance(unit, CactusUnit)
        boxes, images = dict(unit.boxes), []
        for picture in unit.pictures:
            image = read_gray(unit.root / picture.file)
            left, top, right, bottom = boxes[image.shape[1], image.shape[0]]
            images.append(square(image[top:bottom, left:right]))
        grades = [np.nan if p.grade is None else p.grade for p in unit.pictures]
        views = np.full(len(images), LABELS.index(unit.target_view), np.int64)
        return recorded(unit, images, views=views, grades=np.array(grades, np.float32))

    def _check(self, picture: Picture) -> tuple[Size | Fault, bytes]:
        """Return an image's size, or what is wrong with it, and the sha256 of the file."""
        content, path = b"", self.root / picture.file
        try:
            if reason := open_folder(self.root).fault(path):
                raise Fault(Kind.UNREADABLE_IMAGE, reason)
            content = path.read_bytes()
            checked: Size | Fault = check_jpeg(content)
        except Fault as error:
            checked = error
        except OSError as error:
            checked = Fault(Kind.DAMAGED_JPEG, f"{error.strerror}")
        return checked, hashlib.sha256(content).digest()

    def _box(self, size: Size, pictures: Sequence[Picture]) -> Box:
        """Return the crop of all images of one size."""
        if self.config.crop == "none":
            return 0, 0, *size
        if self.config.crop != "auto":
            box = _fixed_box(self.config.crop)
            if box[2] > size[0] or box[3] > size[1]:
                raise RacinesError(
                    f"data.cactus.crop {self.config.crop}: {pictures[0].file} has "
                    f"{resolution(size)} pixels only"
                )
            return box
        chosen = pictures[:: max(1, len(pictures) // _SAMPLE)]
        return sector_box([read_gray(self.root / picture.file) for picture in chosen])

    def _units(
        self, kept: Sequence[Picture], boxes: tuple[tuple[Size, Box], ...]
    ) -> Iterator[CactusUnit]:
        folders: dict[tuple[str, str], list[Picture]] = defaultdict(list)
        for picture in kept:
            folders[picture.view, picture.subfolder].append(picture)
        numbers = defaultdict(count)
        for (view, _), pictures in folders.items():
            for run in runs(pictures, self.config.run):
                name = f"{view.lower()}-{next(numbers[view]):03d}"
                yield CactusUnit(name, "cactus", view, len(run), self.root, tuple(run), boxes)


def _fixed_box(text: str) -> Box:
    """Read left,top,right,bottom, and refuse what is no such box."""
    match = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*", text)
    left, top, right, bottom = map(int, match.groups()) if match else (0, 0, 0, 0)
    if left >= right or top >= bottom:
        raise RacinesError(
            f"data.cactus.crop {text!r}: give auto, none, or left,top,right,bottom in pixels"
        )
    return left, top, right, bottom


def sector_box(images: Sequence[np.ndarray]) -> Box:
    """Return the box of the sector in (H, W) uint8 images of one screen layout.

    Logos, scales and text are the same in every image and drop out, however bright; so does what
    is black. The largest connected region that is left is the sector. With fewer than eight images
    it is the largest region that is not black in their mean. A screen without such a region is
    returned whole.
    """
    stack = np.stack(images).astype(np.float32)
    height, width = stack.shape[1:]
    lively = stack.std(0) > _MOVES if len(stack) >= _FEWEST else stack.mean(0) > _DARK
    # Opening cuts ticks and text that touch the sector; closing joins speckle to one region.
    region = ndimage.binary_closing(lively, np.ones((5, 5), bool), border_value=0) | lively
    region = ndimage.binary_opening(region, np.ones((7, 7), bool))
    labels = np.empty(region.shape, np.int32)
    ndimage.label(region, output=labels)
    sizes = np.bincount(labels.ravel())[1:]
    if not len(sizes) or sizes.max() < _SMALLEST * height * width:
        return 0, 0, width, height
    rows, columns = ndimage.find_objects(labels)[int(sizes.argmax())]
    return int(columns.start), int(rows.start), int(columns.stop), int(rows.stop)
