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
from collections.abc import Mapping, Sequence

import numpy as np

from racines_data.sources.images import Fault, Kind

TIME, WRENCH, POSE, CONTROL = 0, slice(1, 7), slice(7, 23), slice(23, 29)
"""Columns of a log as one row of 29 numbers; the pose is a 4×4 matrix, row by row."""
WIDTH = 29
FIELDS = ("Time", "Force and Torque", "Pose Matrix (ROT)", "Control Effort (CO)")
_HEADINGS = re.compile(r"^[ \t]*(" + "|".join(map(re.escape, FIELDS)) + r"):", re.MULTILINE)
_DIGITS = 8


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
