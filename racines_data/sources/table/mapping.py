"""What a mapping says: where poses, times, images, forces and labels of a recording stand, and how.

Every field has its comment here, which `racines data map` writes into the file. Names of columns in
braces and `*` may stand in paths; see `inputs`. Rotations turn the probe's axes into the tracker's
or the robot's: p_base = R p_probe + t.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from racines_data.errors import RacinesError
from racines_data.sources.table.inputs import named_file

Length = Literal["m", "cm", "mm"]
TimeUnit = Literal["s", "ms", "us", "ns", "iso"]
Angle = Literal["rad", "deg"]
Matrix4 = tuple[
    tuple[float, float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float, float],
]
LARGEST = 1_000_000
"""Bytes of a mapping file, at most."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Time(_Part):
    """When a row was recorded: a column, or a constant rate."""

    column: str | None = Field(
        default=None, description="column of the time; null where there is none"
    )
    unit: TimeUnit = Field(
        default="s", description="s, ms, us, ns, or iso (2024-05-01T12:00:00.040)"
    )
    rate: float | None = Field(
        default=None, gt=0, description="rows a second, where no column has times"
    )
    start: float = Field(default=0.0, description="time of the first row, s, with a rate")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.column is None) == (self.rate is None):
            raise ValueError("give a column, or a rate (rows a second): one of the two")
        return self


class Position(_Part):
    """Where the probe is."""

    columns: tuple[str, ...] = Field(description="x, y, z; or one column that lists the three")
    unit: Length = Field(description="m, cm or mm")

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (1, 3))


class Quaternion(_Part):
    """A rotation as a unit quaternion."""

    kind: Literal["quaternion"] = Field(description="quaternion, matrix, euler, vector, none")
    columns: tuple[str, ...] = Field(description="the four, in the order below; or one list")
    order: Literal["wxyz", "xyzw"] = Field(description="which of the four columns is w: wxyz, xyzw")

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (1, 4))


class RotationMatrix(_Part):
    """A rotation (9 numbers), or a whole pose (12 or 16)."""

    kind: Literal["matrix"]
    columns: tuple[str, ...] = Field(description="9, 12 or 16 columns, or one that lists them")
    layout: Literal["rows", "columns"] = Field(
        default="rows", description="rows: r11 r12 r13 …; columns: r11 r21 r31 …"
    )
    unit: Length | None = Field(
        default=None, description="unit of the position in it, for 12 and 16"
    )

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (1, 9, 12, 16))


class Euler(_Part):
    """A rotation as three angles."""

    kind: Literal["euler"]
    columns: tuple[str, ...] = Field(description="the three angles, in the order below")
    order: str = Field(
        pattern="^([xyz]{3}|[XYZ]{3})$",
        description="axes in order of turning: xyz about fixed axes, XYZ about the turned ones",
    )
    unit: Angle = Field(description="rad or deg")

    @model_validator(mode="after")
    def _count(self) -> Self:
        if any(a == b for a, b in zip(self.order, self.order[1:], strict=False)):
            raise ValueError(f"order {self.order}: an axis stands twice in a row")
        return _counted(self, self.columns, (1, 3))


class RotationVector(_Part):
    """A rotation as its axis times its angle, as some arms log it."""

    kind: Literal["vector"]
    columns: tuple[str, ...] = Field(description="the three components, or one list")
    unit: Angle = Field(description="rad or deg")

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (1, 3))


class NoRotation(_Part):
    """The probe does not turn; `calibration.probe_to_tracker` says how it is held."""

    kind: Literal["none"]


Rotation = Annotated[
    Quaternion | RotationMatrix | Euler | RotationVector | NoRotation, Field(discriminator="kind")
]


class Poses(_Part):
    """The table of poses."""

    file: str = Field(description="CSV, TSV, Parquet, JSON or JSONL; with *, one file a sweep")
    records: str | None = Field(
        default=None, description="key of a JSON file that holds the list of rows"
    )
    separator: str | None = Field(
        default=None, min_length=1, max_length=1, description="of a CSV; null: found out"
    )
    decimal_comma: bool = Field(default=False, description="numbers are written 1,5 instead of 1.5")
    sweep: str | None = Field(
        default=None, description="column that names the sweep; null: one a file"
    )
    time: Time = Field(description="time of a row")
    position: Position | None = Field(default=None, description="null where the matrix holds it")
    rotation: Rotation = Field(description="kind: quaternion, matrix, euler, vector or none")
    invert: bool = Field(
        default=False, description="the pose given is of the tracker in the probe's frame"
    )
    tolerance: float = Field(
        default=1e-3,
        gt=0,
        lt=0.1,
        description="largest error of a rotation, per element of R Rᵀ - 1",
    )

    @model_validator(mode="after")
    def _where(self) -> Self:
        whole = isinstance(self.rotation, RotationMatrix) and len(self.rotation.columns) in (12, 16)
        listed = isinstance(self.rotation, RotationMatrix) and len(self.rotation.columns) == 1
        if self.position is None and not (whole or listed):
            raise ValueError("position is left out, and only a matrix of 12 or 16 would hold it")
        if self.position is not None and whole:
            raise ValueError("position stands twice: the matrix of 12 or 16 holds one; leave it")
        if self.position is None and (whole or listed) and self.rotation.unit is None:  # pyright: ignore
            raise ValueError("rotation.unit: say the unit of the position in the matrix: m, cm, mm")
        return self


class Calibration(_Part):
    """Constant transforms that carry the pose from what was tracked to the image; 4×4, by rows."""

    unit: Length = Field(default="mm", description="unit of their translations")
    image_to_probe: Matrix4 | None = Field(
        default=None, description="from the image to what is tracked"
    )
    image_scaled: bool = Field(
        default=False,
        description="image_to_probe maps pixels: its columns are divided by their lengths",
    )
    probe_to_tracker: Matrix4 | None = Field(
        default=None, description="how the probe is held, where rows have positions alone"
    )
    tracker_to_base: Matrix4 | None = Field(
        default=None, description="from the tracker to the robot base"
    )


class Forces(_Part):
    """Force, and torque if any, on the probe in its own axes."""

    columns: tuple[str, ...] = Field(description="fx fy fz, or fx fy fz tx ty tz")
    unit: Literal["N", "mN", "gf"] = Field(default="N", description="N, mN, or gf (grams-force)")
    torque_unit: Literal["N·m", "N·mm"] = Field(default="N·m", description="N·m or N·mm")

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (3, 6))


class Controls(_Part):
    """Commanded velocity of the probe in the frame of the poses."""

    columns: tuple[str, ...] = Field(description="vx vy vz wx wy wz")
    unit: Literal["m/s", "mm/s"] = Field(default="m/s", description="m/s or mm/s")
    turn_unit: Literal["rad/s", "deg/s"] = Field(default="rad/s", description="rad/s or deg/s")

    @model_validator(mode="after")
    def _count(self) -> Self:
        return _counted(self, self.columns, (6,))


class Labels(_Part):
    """Views and grades, if any."""

    view: str | None = Field(
        default=None, description="column of what a frame shows; empty: unknown"
    )
    grade: str | None = Field(
        default=None, description="column of the grade, 1 to 10 of a known view; empty: unknown"
    )
    target_view: str | None = Field(default=None, description="column of what a sweep aims at")
    session: str | None = Field(
        default=None, description="column of the session (patient, day); null: one"
    )
    views: tuple[str, ...] | None = Field(
        default=None, description="names of views; null: the cardiac five"
    )
    names: dict[str, str] = Field(
        default={}, description="views by the names that the table gives them"
    )


class Clock(_Part):
    """Times of the images, where they have a clock of their own."""

    file: str | None = Field(
        default=None, description="table with a row an image; may hold {sweep}"
    )
    time: Time = Field(description="time of an image")


class Sector(_Part):
    """What of the image is echo; all else becomes black. Pixels of the image as it is stored."""

    apex: tuple[float, float] = Field(description="x, y where the sector's edges meet")
    radii: tuple[float, float] = Field(description="from and to, pixels from the apex")
    angles: tuple[float, float] = Field(
        description="from and to, degrees from straight down, positive to the right"
    )


class Images(_Part):
    """Where the images are."""

    path: str = Field(
        description="{column} names each image, * matches them in order, or a video, an array, an "
        ".mha, a DICOM file a sweep; {sweep} and {row:04d} may stand in it"
    )
    index: str | None = Field(
        default=None, description="column of the frame number (from 0) in a video"
    )
    clock: Clock | None = Field(
        default=None, description="times of the images; null: image n is of row n"
    )
    orientation: Literal["", "MF", "UF", "MN", "UN"] = Field(
        default="",
        description="UF: mirrored left to right, MN: upside down, UN: both, MF: as stored",
    )
    crop: tuple[int, int, int, int] | None = Field(
        default=None, description="left, top, right, bottom in pixels; null: all of it"
    )
    sector: Sector | None = Field(
        default=None, description="apex, radii and angles; null: all of it"
    )


class Match(_Part):
    """How images find their poses by time, where they have a clock of their own."""

    how: Literal["nearest", "interpolate"] = Field(
        default="interpolate", description="nearest row, or between the two (slerp)"
    )
    max_gap: float = Field(default=0.05, gt=0, description="farthest row that counts, s")
    offset: float = Field(default=0.0, description="added to the images' times, s")


class Mapping(_Part):
    """All there is to say of a recording."""

    frame: Literal["robot", "tracker"] = Field(
        description="robot: z up, the probe scans from above, within 2 m; tracker: any axes"
    )
    segments: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="trajectories that each sweep is cut into, so that splits exist",
    )
    poses: Poses
    calibration: Calibration = Field(default=Calibration())
    forces: Forces | None = Field(default=None, description="null where none were measured")
    controls: Controls | None = Field(default=None, description="null where none were commanded")
    labels: Labels = Field(default=Labels())
    images: Images
    match: Match = Field(default=Match())

    @model_validator(mode="after")
    def _held(self) -> Self:
        held = self.calibration.probe_to_tracker is not None
        if isinstance(self.poses.rotation, NoRotation) and not held:
            raise ValueError(
                "poses.rotation is none, so calibration.probe_to_tracker has to say how the probe "
                "is held: give it"
            )
        if held and not isinstance(self.poses.rotation, NoRotation):
            raise ValueError(
                "calibration.probe_to_tracker goes with poses.rotation of kind none: leave it out"
            )
        return self


def _counted(part: Any, columns: tuple[str, ...], counts: tuple[int, ...]) -> Any:
    if len(columns) not in counts:
        several = " or ".join(map(str, counts))
        raise ValueError(f"{len(columns)} columns, where {several} are needed")
    if len(set(columns)) < len(columns):
        twice = next(name for name in columns if columns.count(name) > 1)
        raise ValueError(f"column {twice!r} stands twice")
    return part


def read_mapping(path: Path) -> Mapping:
    """Read a mapping.

    Raises:
        RacinesError: no such file, no YAML, or each unknown, missing or wrong key by its name.
    """
    named_file(path, "racines data map FOLDER --guess writes a mapping")
    if path.stat().st_size > LARGEST:
        raise RacinesError(f"{path}: larger than {LARGEST} bytes: not a mapping")
    try:
        content = yaml.safe_load(path.read_text("utf-8-sig"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise RacinesError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    return check_mapping(content, str(path))


def check_mapping(content: Any, where: str) -> Mapping:
    """Return the mapping that a document is; `where` names it in the error.

    Raises:
        RacinesError: each unknown, missing or wrong key by its name.
    """
    if not isinstance(content, dict):
        raise RacinesError(f"{where}: expected keys (poses, images, …) and values")
    try:
        return Mapping.model_validate_json(json.dumps(content, default=str), strict=True)
    except ValidationError as error:
        faults = "; ".join(_fault(dict(each)) for each in error.errors(include_url=False))
        raise RacinesError(f"{where}: {faults}") from None
    except (TypeError, ValueError, RecursionError) as error:
        raise RacinesError(f"{where}: not a mapping: {error}") from error


def _fault(error: dict[str, Any]) -> str:
    # The discriminator's value stands in the path of a union's error; it is no key of the file.
    kinds = ("quaternion", "matrix", "euler", "vector", "none")
    place = ".".join(str(part) for part in error["loc"] if part not in kinds) or "mapping"
    kind, value = error["type"], error.get("input")
    if kind == "extra_forbidden":
        return f"{place}: unknown key"
    if kind in ("missing", "union_tag_not_found"):
        key = ".kind" if kind == "union_tag_not_found" else ""
        return f"{place}{key}: needed, and left out"
    said = error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if kind == "value_error":
        return f"{place}: {said}"
    shown = repr(value)
    return f"{place}: {shown if len(shown) < 60 else shown[:57] + '…'}: expected {said}"
