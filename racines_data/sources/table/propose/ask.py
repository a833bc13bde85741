"""Asking for what a guess may have got wrong, one question at a time."""

from collections.abc import Callable
from typing import Any

import yaml

from racines_data.errors import RacinesError
from racines_data.sources.table.mapping import check_mapping

QUESTIONS = (
    ("poses.file", "The table of poses (with *: one file a sweep)"),
    ("poses.sweep", "Column that names the sweep (null: none)"),
    ("poses.time.column", "Column of the time (null: none, then a rate)"),
    ("poses.time.unit", "Its unit: s, ms, us, ns or iso"),
    ("poses.position.columns", "Columns of the position, [x, y, z]"),
    ("poses.position.unit", "Its unit: m, cm or mm"),
    ("poses.rotation.kind", "Rotation as quaternion, matrix, euler, vector or none"),
    ("poses.rotation.columns", "Its columns"),
    ("poses.rotation.order", "Order: of a quaternion wxyz or xyzw; of angles such as xyz or ZYX"),
    ("poses.rotation.unit", "Unit: of angles rad or deg; of a matrix with a position m, cm or mm"),
    ("poses.invert", "Is the pose that of the tracker in the probe's frame (true, false)"),
    ("frame", "Frame of the poses: robot (z up, scanned from above) or tracker"),
    ("images.path", "Images: {column}, a pattern with *, or a file a sweep with {sweep}"),
    ("segments", "Trajectories that each sweep is cut into"),
)
"""Fields in the order in which they are asked for; all others keep their default."""
_ORDERED, _SIZED = ("quaternion", "euler"), ("euler", "vector", "matrix")


def ask_mapping(content: dict[str, Any], prompt: Callable[[str, str], str]) -> dict[str, Any]:
    """Return a document with the answers in the place of what was guessed.

    Args:
        content: What was guessed.
        prompt: Asks a question with a default, and returns the answer.

    Raises:
        RacinesError: an answer is no YAML, or the whole is no mapping.
    """
    for path, question in QUESTIONS:
        kind = _get(content, "poses.rotation.kind")
        if not _applies(content, path, kind):
            continue
        held = _get(content, path)
        default = yaml.safe_dump(held, default_flow_style=True, width=10_000).split("\n")[0]
        answer = prompt(f"{question}\n  {path}", default)
        try:
            value = yaml.safe_load(answer)
        except yaml.YAMLError as error:
            raise RacinesError(f"{path}: {answer!r} is not valid YAML") from error
        if value == held:
            continue
        if path == "poses.rotation.kind":
            content["poses"]["rotation"] = {"kind": value}
        elif path == "poses.time.column" and value is None:
            content["poses"]["time"] = {"rate": float(prompt("Rows a second", "25"))}
        else:
            _set(content, path, value)
    check_mapping(content, "the answers")
    return content


def _applies(content: dict[str, Any], path: str, kind: str) -> bool:
    columns = _get(content, "poses.rotation.columns") or ()
    if path == "poses.time.unit":
        return _get(content, "poses.time.column") is not None
    if path.startswith("poses.position"):
        return _get(content, "poses.position") is not None or len(columns) not in (12, 16)
    if path == "poses.rotation.columns":
        return kind != "none"
    if path == "poses.rotation.order":
        return kind in _ORDERED
    if path == "poses.rotation.unit":
        return kind in _SIZED and not (kind == "matrix" and len(columns) == 9)
    return True


def _get(content: dict[str, Any], path: str) -> Any:
    part: Any = content
    for key in path.split("."):
        part = part.get(key) if isinstance(part, dict) else None
    return part


def _set(content: dict[str, Any], path: str, value: Any) -> None:
    *parents, last = path.split(".")
    part = content
    for key in parents:
        part = part.setdefault(key, {})
    part[last] = value
