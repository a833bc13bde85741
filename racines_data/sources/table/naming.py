"""Which image goes with which row: paths with braces, patterns, frame numbers, clocks."""

from pathlib import Path

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.sources.table.clocks import read_times
from racines_data.sources.table.inputs import Folder, fields_of, fill_in
from racines_data.sources.table.mapping import Mapping
from racines_data.sources.table.pictures.base import Stack
from racines_data.sources.table.pictures.files import Files
from racines_data.sources.table.pictures.opening import ONE_A_SWEEP, open_stack
from racines_data.sources.table.rows import column, numbers, read_table

_FIELD = "images.path"


def open_images(
    folder: Folder, mapping: Mapping, path: Path, sweep: str, table: pl.DataFrame
) -> tuple[Stack, np.ndarray, dict[int, str]]:
    """Return the images of a sweep, the place of each row's, and why those without one have none.

    With a clock of their own, images belong to no row: the places are those of all images.

    Args:
        folder: Where all files are.
        mapping: What says where.
        path: The table, for messages.
        sweep: Name of the sweep as the table has it.
        table: Its T rows.

    Raises:
        RacinesError: a path that leads out of the folder, or as many images as rows are not there.
    """
    clock, rows = mapping.images.clock, table
    if clock is not None:
        rows = _clock_table(folder, mapping, sweep)
    names, missing, listed = _names(folder, mapping.images.path, rows, sweep, path)
    stack = open_stack(names, missing, _FIELD)
    files = isinstance(stack, Files)
    if clock is not None:
        return stack, np.arange(len(stack)), {}
    if mapping.images.index is None:
        if len(stack) != len(table):
            _refuse_counts(stack, len(table), folder, path, sweep)
        return stack, np.arange(len(table)), missing if files else {}
    if files and not listed:
        raise RacinesError(
            "images.index: the path names an image a row: leave the index out, or give a pattern"
        )
    return stack, *_indexed(table, mapping.images.index, len(stack), path)


def _indexed(
    table: pl.DataFrame, name: str, count: int, path: Path
) -> tuple[np.ndarray, dict[int, str]]:
    values = numbers(table, [name], "images.index", path)[:, 0]
    whole = np.isfinite(values) & (values == np.round(values))
    inside = whole & (values >= 0) & (values < count)
    missing = {
        int(row): f"column {name!r} says image {values[row]:g}, of {count} from 0 on"
        for row in np.flatnonzero(~inside)
    }
    if not inside.any():
        raise RacinesError(f"{path}: images.index: no row of column {name!r} is a number of images")
    return np.where(inside, values, 0).astype(int), missing


def _refuse_counts(stack: Stack, rows: int, folder: Folder, path: Path, sweep: str) -> None:
    kind = "rows" if rows < len(stack) else "frames"
    where = f" of sweep {sweep}" if sweep else ""
    file = folder.name(stack.files[0])
    raise RacinesError(
        f"{file}: missing {kind}: {len(stack)} images for {rows} rows{where} in {path.name}: give "
        "images.index (a column with frame numbers), or images.clock (times of the images)"
    )


def clock_files(folder: Folder, mapping: Mapping, sweep: str) -> list[Path]:
    """Return the table with the times of a sweep's images, if there is one."""
    clock = mapping.images.clock
    if clock is None or clock.file is None:
        return []
    field = "images.clock.file"
    if set(fields_of(clock.file, field)) - {"sweep"}:
        raise RacinesError(f"{field}: {clock.file}: only {{sweep}} may stand in it")
    return [folder.file(fill_in(clock.file, {"sweep": sweep}, field), field)]


def _clock_table(folder: Folder, mapping: Mapping, sweep: str) -> pl.DataFrame | None:
    for path in clock_files(folder, mapping, sweep):
        return read_table(path, mapping.poses.separator, mapping.poses.decimal_comma)
    return None


def own_clock(folder: Folder, mapping: Mapping, sweep: str, count: int) -> np.ndarray:
    """Return (N,) seconds of the N images of a sweep, by their own clock."""
    clock = mapping.images.clock
    assert clock is not None
    table = _clock_table(folder, mapping, sweep)
    if table is None:
        if clock.time.column is not None:
            raise RacinesError("images.clock.file: needed for its column; or give a rate")
        return read_times(pl.DataFrame(), clock.time, "images.clock.time", folder.root, count)
    (path,) = clock_files(folder, mapping, sweep)
    times = read_times(table, clock.time, "images.clock.time", path)
    if len(times) != count:
        raise RacinesError(f"{path}: missing frames: {len(times)} times for {count} images")
    if not np.isfinite(times).all():
        row = int(np.flatnonzero(~np.isfinite(times))[0])
        raise RacinesError(f"{path}: images.clock.time: row {row} has no time")
    return times


def _names(
    folder: Folder, template: str, table: pl.DataFrame | None, sweep: str, path: Path
) -> tuple[list[Path | None], dict[int, str], bool]:
    """Return a file an image (or the one of all), why some are not there, and whether listed."""
    fields = fields_of(template, _FIELD)
    own = [name for name in fields if name not in ("sweep", "row")]
    if table is None and len(own) + ("row" in fields) > 0:
        raise RacinesError(
            f"{_FIELD}: {template}: images with a clock but no clock.file have no rows: name them "
            "by a pattern with *"
        )
    by_row = bool(own) or "row" in fields
    if not by_row:
        return [*folder.match(template, _FIELD, sweep=sweep)], {}, True
    assert table is not None
    columns = {name: column(table, name, _FIELD, path).to_list() for name in own}
    found: list[Path | None] = []
    missing: dict[int, str] = {}
    for row in range(len(table)):
        values = {name: each[row] for name, each in columns.items()}
        if None in values.values() or "" in values.values():
            missing[row] = "the row names no image"
            found.append(None)
            continue
        name = fill_in(template, {**values, "sweep": sweep, "row": row}, _FIELD)
        found.append(folder.find(name, _FIELD))
        if found[-1] is None:
            missing[row] = f"{name}: no such file"
    ones = {each for each in found if each is not None and each.suffix.lower() in ONE_A_SWEEP}
    if len(ones) == 1 and len(set(found)) == 1:
        return [ones.pop()], {}, False
    return found, missing, False
