"""What a tissues.yaml says: units, parts, landmarks, views and place. Lengths in it are mm.

parts      what is painted, in order: a mesh, a label, an ellipsoid, or a shell about others
landmarks  points that views are named by, each of one of `WHERE`
views      from landmarks, or from a pose
place      which way faces the probe; of a heart `heart`, which lays it like the patients' hearts
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

from racines_data.config import Settings, fill
from racines_data.errors import RacinesError
from racines_data.patients.labels import LABELS
from racines_data.phantom import abdomen, heart
from racines_data.phantom.anatomy import Tissue
from racines_data.sources.table.inputs import named_file

Vector = tuple[float, float, float]
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""What a file's lengths may be in, mm."""
TISSUES = {each.name: each for each in (*abdomen.TISSUES, *heart.TISSUES)}
"""Tissues that need no numbers of their own, those of the built-in organs."""
WHERE = ("at", "part", "rim")
SORTS = ("mesh", "label", "ellipsoid", "shell")
T = TypeVar("T")


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid in the file's frame."""

    at: Vector
    """Its centre, mm."""
    radii: Vector
    """Along `along`, towards `beside`, and across both, mm."""
    along: Vector = (1.0, 0.0, 0.0)
    beside: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Part:
    """What is painted; one of `mesh`, `label`, `ellipsoid` and `shell` says where."""

    tissue: str
    """One of `TISSUES`, or of the file's own."""
    mesh: str = ""
    """A surface in the folder; `{phase}` stands for the digits of a phase."""
    label: int = 0
    """A number in the label map."""
    ellipsoid: dict[str, Any] = field(default_factory=dict)
    """Of a shape that no file has; see `Ellipsoid`."""
    shell: tuple[str, ...] = ()
    """Parts about which a layer lies."""
    thickness: float = 0.0
    """Of the shell, mm."""
    over: tuple[str, ...] = ()
    """Parts that it may cover, `around` among them: all by default, a shell only what is around."""
    cap: tuple[str, ...] = ()
    """Names of the mesh's open rims, widest first, each of which is closed by a fan."""
    synthetic: str = ""
    """Why it is there though no file has it; an ellipsoid or a shell has to say so."""
    structure: str = ""
    """Of a heart, which of `racines_data.patients.LABELS` it is; its own name by default."""


@dataclass(frozen=True)
class Landmark:
    """A point, at the first phase; `at`, `part` or `rim` says where."""

    radius: float = 15.0
    """Distance from the image plane at which it is all but lost, mm."""
    at: Vector | None = None
    """In the file's frame, mm."""
    part: str = ""
    """The middle of a part."""
    rim: str = ""
    """The middle of a rim that a cap closes."""


@dataclass(frozen=True)
class View:
    """A plane, the way it is looked at, and what it has to show."""

    shows: dict[str, float]
    """Landmarks and their weights."""
    focus: str = ""
    """A landmark on the central beam."""
    beam: tuple[str, ...] = ()
    """Two landmarks: the central beam runs from the first to the second."""
    right: str = ""
    """A landmark of the plane, on the right of the picture."""
    pose: dict[str, Vector] = field(default_factory=dict)
    """In place of these: `focus`, a point, mm, and the directions `beam` and `right`."""
    indentation: float = 6.0
    """Depth of the tip under the surface at the nominal pose, mm."""
    title: str = ""


@dataclass(frozen=True)
class Place:
    """How an organ lies in the block."""

    up: Vector = (0.0, 0.0, 1.0)
    """The file's direction that faces the probe."""
    ahead: Vector = (1.0, 0.0, 0.0)
    """The file's direction towards +x of the robot, as far as `up` leaves it."""
    depth: float = 8.0
    """Of the organ's top under the surface, mm."""
    x: float = 490.0
    y: float = 16.0
    """Of its middle in the robot's frame, mm."""


@dataclass(frozen=True)
class HeartFrame:
    """Landmarks that lay a heart like those of the patients."""

    base: str
    """The middle of the mitral valve."""
    apex: str
    """Of the left ventricle."""
    right: str
    """The middle of the tricuspid valve: the plane of the three shows four chambers."""


@dataclass(frozen=True)
class Head:
    """What stands beside the sections."""

    name: str
    title: str = ""
    source: str = ""
    """Where the files come from."""
    licence: str = ""
    units: str = "mm"
    """Of the files: `mm`, `cm` or `m`; lengths in the YAML are mm in any case."""
    around: str = "gel"
    """Tissue of what lies around the organ."""
    voxel: float = 1.0
    """Edge of a voxel of what meshes are painted into, mm."""


@dataclass(frozen=True)
class Sheet:
    """A tissues.yaml."""

    path: Path
    head: Head
    tissues: dict[str, Tissue]
    """By name, `around` first."""
    parts: dict[str, Part]
    landmarks: dict[str, Landmark]
    views: dict[str, View]
    place: Place
    heart: HeartFrame | None

    def refuse(self, where: str, why: str) -> RacinesError:
        """Return the error that names the file and a place in it."""
        return RacinesError(f"{self.path}: {where}: {why}")


_SECTIONS = ("tissues", "parts", "landmarks", "views")


def read_sheet(path: Path) -> Sheet:
    """Read a tissues.yaml and check all that follows from it alone.

    Raises:
        RacinesError: absent, no YAML, an unknown or a missing key, or a name that stands nowhere.
    """
    values = _read(path)
    rest = (*_SECTIONS, "place", "heart")
    head = _fill(Head, path, {k: v for k, v in values.items() if k not in rest}, "")
    sections: dict[str, dict[str, Any]] = {}
    for name in _SECTIONS:
        sections[name] = values.get(name) or {}
        if not isinstance(sections[name], dict):
            raise RacinesError(f"{path}: {name}: {sections[name]!r} is no mapping: give names")
    own = {n: _fill(Tissue, path, {"name": n, **v}, f"tissues.{n}")
           for n, v in sections["tissues"].items()}  # fmt: skip
    sheet = Sheet(
        path,
        head,
        {**TISSUES, **own},
        {n: _fill(Part, path, v, f"parts.{n}") for n, v in sections["parts"].items()},
        {n: _fill(Landmark, path, v, f"landmarks.{n}") for n, v in sections["landmarks"].items()},
        {n: _fill(View, path, v, f"views.{n}") for n, v in sections["views"].items()},
        _fill(Place, path, values.get("place") or {}, "place"),
        _fill(HeartFrame, path, values["heart"], "heart") if values.get("heart") else None,
    )
    _check_head(sheet)
    for name, part in sheet.parts.items():
        _check_part(sheet, name, part)
    _check_marks(sheet)
    return sheet


def _read(path: Path) -> dict[str, Any]:
    named_file(path, "name a tissues.yaml (docs/own-anatomy.md)")
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RacinesError(f"{path}: not valid YAML: {error}") from error
    if not isinstance(values, dict):
        raise RacinesError(f"{path}: expected a mapping with name, parts, landmarks and views")
    return values


def _fill(kind: type[T], path: Path, values: Any, where: str) -> T:
    if not isinstance(values, Mapping):
        raise RacinesError(f"{path}: {where}: {values!r} is no mapping: give keys and values")
    known = {each.name for each in fields(kind)}  # pyright: ignore[reportArgumentType]
    if kind is Head and (extra := sorted(map(str, set(values) - known))):
        told = ", ".join((*sorted(known), *_SECTIONS, "place", "heart"))
        raise RacinesError(f"{path}: {extra[0]}: unknown key; known: {told}")
    return fill(kind, Settings(values, str(path)), where)


def _check_head(sheet: Sheet) -> None:
    head = sheet.head
    if not head.name.replace("-", "").replace("_", "").isalnum() or not head.name.isascii():
        raise sheet.refuse("name", f"{head.name!r}: use letters, digits, - and _")
    if head.units not in UNITS:
        raise sheet.refuse("units", f"{head.units!r}: give one of {', '.join(UNITS)}")
    if not 0.3 <= head.voxel <= 3.0:
        raise sheet.refuse("voxel", f"{head.voxel:g} mm: give 0.3 to 3")
    if not (sheet.parts and sheet.views):
        raise sheet.refuse("parts, views", "none: an organ has parts and a view to look for")
    _known_tissue(sheet, "around", head.around)


def _known_tissue(sheet: Sheet, where: str, name: str) -> None:
    if name not in sheet.tissues:
        known = ", ".join(sorted(sheet.tissues))
        raise sheet.refuse(where, f"unknown tissue {name!r}: one of {known}, or give its numbers "
                           "under tissues")  # fmt: skip


def _check_part(sheet: Sheet, name: str, part: Part) -> None:
    where = f"parts.{name}"
    _known_tissue(sheet, f"{where}.tissue", part.tissue)
    sorts = [sort for sort in SORTS if getattr(part, sort)]
    if len(sorts) != 1:
        raise sheet.refuse(where, f"has {', '.join(sorts) or 'no shape'}: give one of "
                           + ", ".join(SORTS))  # fmt: skip
    if sorts[0] in ("ellipsoid", "shell") and not part.synthetic:
        raise sheet.refuse(
            f"{where}.synthetic", f"{sorts[0]}: is in no file: say why the part is there"
        )
    if part.ellipsoid:
        _fill(Ellipsoid, sheet.path, part.ellipsoid, f"{where}.ellipsoid")
    if part.shell and not part.thickness > 0:
        raise sheet.refuse(f"{where}.thickness", "a shell needs a thickness, mm, above 0")
    if part.cap and not part.mesh:
        raise sheet.refuse(f"{where}.cap", "only a mesh has rims to close")
    before = list(sheet.parts)[: list(sheet.parts).index(name)]
    for key in ("shell", "over"):
        for other in getattr(part, key):
            if other not in before and not (key == "over" and other == "around"):
                told = ", ".join(before) or "none"
                raise sheet.refuse(
                    f"{where}.{key}", f"{other!r} is no part painted before it: {told}"
                )
    if sheet.heart and (part.structure or name) not in LABELS:
        raise sheet.refuse(f"{where}.structure", f"{part.structure or name!r} is no structure of a "
                           f"heart: one of {', '.join(LABELS)}")  # fmt: skip


def _check_marks(sheet: Sheet) -> None:
    rims = {rim for part in sheet.parts.values() for rim in part.cap}
    for name, mark in sheet.landmarks.items():
        where = f"landmarks.{name}"
        given = [key for key in WHERE if getattr(mark, key)]
        if len(given) != 1:
            raise sheet.refuse(where, f"has {', '.join(given) or 'no place'}: give one of "
                               + ", ".join(WHERE))  # fmt: skip
        if mark.part and mark.part not in sheet.parts:
            raise sheet.refuse(f"{where}.part", f"{mark.part!r} is no part")
        if mark.rim and mark.rim not in rims:
            told = ", ".join(sorted(rims)) or "none"
            raise sheet.refuse(f"{where}.rim", f"{mark.rim!r} is no rim that a cap names: {told}")
        if not mark.radius > 0:
            raise sheet.refuse(f"{where}.radius", "give a length above 0, mm")
    for name, view in sheet.views.items():
        _check_view(sheet, f"views.{name}", view)
    for key, mark in asdict(sheet.heart).items() if sheet.heart else ():
        known_mark(sheet, f"heart.{key}", mark)


def known_mark(sheet: Sheet, where: str, name: str) -> None:
    """Refuse the name of a landmark that is none."""
    if name not in sheet.landmarks:
        told = ", ".join(sheet.landmarks) or "none"
        raise sheet.refuse(where, f"{name!r} is no landmark: {told}")


def _check_view(sheet: Sheet, where: str, view: View) -> None:
    if not view.shows or not all(weight > 0 for weight in view.shows.values()):
        raise sheet.refuse(f"{where}.shows", "give landmarks and weights above 0")
    for mark in view.shows:
        known_mark(sheet, f"{where}.shows", mark)
    if view.pose:
        if set(view.pose) != {"focus", "beam", "right"} or view.focus or view.beam or view.right:
            raise sheet.refuse(
                f"{where}.pose", "give focus, beam and right there, and nowhere else"
            )
        return
    if len(view.beam) != 2:
        raise sheet.refuse(f"{where}.beam", "give two landmarks, from one to the other")
    for key, mark in (
        ("focus", view.focus),
        *(("beam", m) for m in view.beam),
        ("right", view.right),
    ):
        known_mark(sheet, f"{where}.{key}", mark)
