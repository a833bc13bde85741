"""The text beside each image of the published recordings, read and written.

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
from collections.abc import Sequence

import numpy as np

from racines_data.errors import RacinesError

TIME, WRENCH, POSE, CONTROL = 0, slice(1, 7), slice(7, 23), slice(23, 29)
"""Columns of a log as one row of 29 numbers; the pose is a 4×4 matrix, row by row."""
WIDTH = 29
FIELDS = ("Time", "Force and Torque", "Pose Matrix (ROT)", "Control Effort (CO)")
_HEADINGS = re.compile(r"^[ \t]*(" + "|".join(map(re.escape, FIELDS)) + r"):", re.MULTILINE)
_DIGITS = 8


class DamagedLog(RacinesError):
    """A log that cannot be used: `kind` of damage, `field` concerned, and detail."""

    def __init__(self, kind: str, field: str, detail: str) -> None:
        super().__init__(f"{kind}: {field}: {detail}")
        self.kind, self.field, self.detail = kind, field, detail


def parse_log(text: str) -> list[float]:
    """Return the 29 numbers of a log: time, wrench, pose matrix, control effort, as they stand.

    Raises:
        DamagedLog: a field is missing or stands twice, is not numbers, or has the wrong shape.
    """
    parts = _HEADINGS.split(text)
    fields = dict(zip(parts[1::2], parts[2::2], strict=True))
    for name in FIELDS:
        if name not in fields:
            raise DamagedLog("unreadable log", name, "the field is missing")
    if len(parts) > 2 * len(FIELDS) + 1:
        raise DamagedLog("unreadable log", "", "a field stands twice")
    time = _rows("Time", fields["Time"])
    if len(time) != 1 or len(time[0]) != 1:
        raise DamagedLog("unreadable log", "Time", f"{fields['Time'].strip()!r} is not seconds")
    pose = _rows(FIELDS[2], fields[FIELDS[2]])
    if [len(row) for row in pose] != [4, 4, 4, 4]:
        shape = "×".join(map(str, _shape(pose)))
        raise DamagedLog("wrong matrix shape", FIELDS[2], f"{shape} numbers instead of 4×4")
    wrench, control = (_six(name, fields[name]) for name in (FIELDS[1], FIELDS[3]))
    return [*time[0], *wrench, *(number for row in pose for number in row), *control]


def _rows(name: str, text: str) -> list[list[float]]:
    rows = text.replace(",", " ").replace("[", " ").split("]")
    try:
        return [row for row in ([float(word) for word in row.split()] for row in rows) if row]
    except ValueError as error:
        raise DamagedLog("unreadable log", name, f"{error}") from error


def _shape(rows: Sequence[Sequence[float]]) -> tuple[int | str, ...]:
    widths = sorted({len(row) for row in rows})
    return len(rows), "/".join(map(str, widths)) or 0


def _six(name: str, text: str) -> list[float]:
    rows = _rows(name, text)
    if [len(row) for row in rows] not in ([6], [1] * 6):
        shape = "×".join(map(str, _shape(rows)))
        raise DamagedLog("wrong matrix shape", name, f"{shape} numbers instead of six")
    return [number for row in rows for number in row]


def format_log(row: np.ndarray) -> str:
    """Return the text of a log from (29,) numbers; absent ones are printed as nan.

    Numbers are printed as NumPy does with eight fixed decimals: 1e-8 m, rad, N. The control effort
    stands on one line, as readers expect that match it line by line.
    """
    time = np.format_float_positional(row[TIME], unique=True, trim="0")
    wrench, pose, control = (
        _array(row[part].reshape(shape))
        for part, shape in ((WRENCH, (6, 1)), (POSE, (4, 4)), (CONTROL, (1, 6)))
    )
    return (
        f"Time: {time}\nForce and Torque: {wrench}\nPose Matrix (ROT):\n{pose}\n"
        f"Control Effort (CO): {control[1:-1]}\n"
    )


def _array(values: np.ndarray) -> str:
    """Print an (R, C) array as NumPy does; its own printer takes fifty times as long."""
    # The sum turns a negative zero into zero.
    words = [f"{number + 0.0:.{_DIGITS}f}" for number in values.round(_DIGITS).ravel().tolist()]
    width = max(map(len, words))
    columns = values.shape[1]
    rows = [
        "[" + " ".join(word.rjust(width) for word in words[start : start + columns]) + "]"
        for start in range(0, len(words), columns)
    ]
    return "[" + "\n ".join(rows) + "]"
