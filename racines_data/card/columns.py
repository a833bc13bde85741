"""What is said of columns: their table on the card, and the descriptions in Croissant.

Poses are in the frame and the unit of the recordings: metres from a robot's base, metres from a
tracker, or pixels in the frame of a file of poses. Both texts take them from the manifest.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from datasets import ClassLabel

from racines_data.manifest import is_turned, scale_known
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.sources.gate.bounds import manifest_bounds
from racines_data.tables import Markdown, markdown_table

PIXELS_UNIT = "pixels"
"""Unit of positions where the scale is not known."""
_COLUMNS = (
    ("image", "PNG, 8-bit gray", "", "128×128; beam axis down, probe at the top centre"),
    ("force_x, force_y, force_z", "float32", "", "force at the sensor; null if unmeasured"),
    ("torque_x, torque_y, torque_z", "float32", "", "torque there; null if unmeasured"),
    ("position_x, position_y, position_z", "float32", "", ""),
    ("rotation_x, rotation_y, rotation_z", "float32", "", "extrinsic xyz Euler angles"),
    ("timestamp", "float64", "s", "increases along a trajectory; null without a clock"),
    ("control_x, control_y, control_z", "float32", "", "commanded velocity; null if unknown"),
    ("control_rx, control_ry, control_rz", "float32", "", "commanded rate; null if unknown"),
    ("view", "label", "", "what the frame shows; null if unknown"),
    ("grade", "float32", "", "quality of the view, 1–10, 0 where there is none; null if unknown"),
    ("view_predicted", "label", "", "a grader's opinion; null until annotated"),
    ("grade_predicted", "float32", "", "a grader's opinion; null until annotated"),
    ("target_view", "string", "", "what the sweep aimed at; Random for nothing"),
    ("phantom", "int32", "", "seed of the simulated anatomy, 0 the canonical; null if recorded"),
    ("source", "label", "", "where the frame comes from"),
    ("session", "string", "", "recording session; in `multi_phantom` the heart"),
    ("trajectory", "string", "", "sweep; wholly in one split"),
    ("frame", "int32", "", "number of the frame in its trajectory, from 0"),
)
"""Name, type, unit and meaning of the columns of `frames`; the dataset tells what position is told
and the units of poses and controls."""
PATIENT_COLUMNS = (
    ("patient", "int64", "", "seed of the patient; wholly in one split"),
    ("cardiac_phase", "float64", "", "of the beat, in [0, 1) from end diastole; 0 where still"),
    ("respiratory_phase", "float64", "", "of the breath, in [0, 1) from breathed out; 0 if still"),
    ("mask", "PNG, 8-bit labels", "", "what each pixel shows; null where none was asked for"),
)
"""The same of what frames of patients have besides."""
TURN_COLUMNS = (
    ("cardiac_phase", "float64", "", "of the beat, in [0, 1); null where the heart is still"),
    ("turn_angle", "float64", "°", "of the turn about the apex, in [0, 180): then it is mirrored"),
    ("train_angle", "float64", "°", "from there to the nearest turn of the train split"),
)
"""The same of what frames of a rotation about the apex have besides."""
_DESCRIPTIONS = {
    "image": "The frame: 8-bit gray, 128 by 128, beam axis down, probe at the top centre; PNG.",
    "timestamp": "Time of the frame, s; null where there is no clock.",
    "view": "What the frame shows; null where unknown.",
    "grade": "Quality of the view, 0-10; null where unknown.",
    "view_predicted": "The view by a trained grader; null until annotated.",
    "grade_predicted": "The grade, 0-10, by a trained grader; null until annotated.",
    "target_view": "What the sweep aimed at; Random for none.",
    "phantom": "Seed of the simulated anatomy, 0 the canonical one; null for recordings.",
    "source": "Where the frame comes from.",
    "session": "Recording session.",
    "trajectory": "Name of the sweep; a sweep lies wholly in one split.",
    "frame": "Number of the frame in its trajectory.",
    "patient": "Seed of the simulated patient; a patient lies wholly in one split.",
    "cardiac_phase": "Where the heart is in its beat, in [0, 1) from end diastole.",
    "respiratory_phase": "Where the chest is in its breath, in [0, 1) from breathed out.",
    "turn_angle": "Angle of the turn about the apex, in [0, 180) degrees.",
    "train_angle": "Angle from the turn to the nearest turn of the train split, degrees.",
    "mask": "Label of what each pixel of the image shows; PNG; null where there are no masks.",
    "split": "Split of the trajectory.",
    "frames": "Number of frames of the trajectory.",
    "duration": "Duration of the trajectory, s.",
    "digest": "sha256 of the trajectory's pixels and numbers.",
}


def unit_of(column: str, scaled: bool = True) -> str:
    """Return the SI unit of a parameter or a control; without a known scale lengths are pixels."""
    kind, _, axis = column.partition("_")
    length = "m" if scaled else PIXELS_UNIT
    velocity = "rad/s" if axis.startswith("r") else f"{length}/s"
    units = {"force": "N", "torque": "N·m", "position": length, "rotation": "rad"}
    return (units | {"control": velocity})[kind]


def frame_of(manifest: Mapping[str, Any]) -> str:
    """Return in words in which frame poses are; see `manifest.config_manifest` for other configs.

    Only where the third axis is known to point up is it a robot's base.
    """
    if is_turned(manifest):
        return "frame of the file of poses"
    if manifest_bounds(manifest).upright:
        return "robot base frame"
    return "tracker's frame"


def frame_note(manifest: Mapping[str, Any]) -> str:
    """Return the beginning of a sentence on frame and units of the columns."""
    if not manifest.get("poses", True):
        return "No poses were recorded"
    unscaled = f"positions in {PIXELS_UNIT}, angles in radians"
    frame = frame_of(manifest).capitalize()
    return f"{frame}, {'SI units' if scale_known(manifest) else unscaled}"


def _place(manifest: Mapping[str, Any]) -> str:
    """Return what position is told: the tracked marker's where nothing says where the tip is."""
    if not manifest.get("poses", True):
        return "null: no poses were recorded"
    point = "marker on the probe" if manifest["source"] == "tracked" else "probe's tip"
    return f"{point}, {frame_of(manifest)}"


def frame_columns(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, type, unit and meaning of the columns of `frames`."""
    for names, kind, unit, meaning in _COLUMNS:
        first = names.partition(",")[0]
        if first in (*PARAMETERS, *CONTROLS):
            unit = unit_of(first, scale_known(manifest))
        yield names, kind, unit, meaning or _place(manifest)


def columns_table(columns: Iterable[tuple[str, str, str, str]]) -> str:
    """Return a table of columns."""
    rows = [(Markdown(f"`{names}`".replace(", ", "`, `")), *about) for names, *about in columns]
    return markdown_table(("column", "type", "unit", "meaning"), rows)


def describe_column(name: str, feature: Any, manifest: Mapping[str, Any]) -> str:
    """Return the description of a column in Croissant; the manifest is that of its config."""
    kind, _, axis = name.partition("_")
    if name in (*PARAMETERS, *CONTROLS):
        unit = unit_of(name, scale_known(manifest))
        frame = "sensor" if kind in ("force", "torque") else frame_of(manifest)
        if kind == "control":
            return f"Commanded velocity {axis}, {unit}, {frame}; null where unknown."
        euler = "; extrinsic xyz Euler angle" if kind == "rotation" else ""
        return f"{kind.capitalize()} {axis}, {unit}, {frame}{euler}; nullable."
    names = f" One of {', '.join(feature.names)}." if isinstance(feature, ClassLabel) else ""
    return f"{_DESCRIPTIONS[name]}{names}"
