"""From a mapping to sweeps: rows in groups, their poses and times, and the image of each.

    table ──groups──> drafts (as the columns have them) ──doubts──> sweeps (what is sound, matched)

A row or an image that cannot be used stands in the report with its reason; what is wrong with a
whole sweep is an error.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.sources.folder import Report
from racines_data.sources.gate.numbers import backward, rotation_faults
from racines_data.sources.images import Kind, resolution
from racines_data.sources.table.clocks import match, read_times
from racines_data.sources.table.inputs import Folder
from racines_data.sources.table.labels import read_controls, read_labels, read_wrench
from racines_data.sources.table.mapping import Mapping
from racines_data.sources.table.naming import open_images, own_clock
from racines_data.sources.table.pictures.base import Stack
from racines_data.sources.table.poses import calibrate, read_poses
from racines_data.sources.table.region import check_region
from racines_data.sources.table.rows import read_table, texts


@dataclass(frozen=True)
class Draft:
    """The rows of one sweep, as the columns have them."""

    name: str
    """Unique, fit for a file's name."""
    text: str
    """Name of the sweep as the table or the file has it."""
    path: Path
    """The table."""
    table: pl.DataFrame
    """Its rows."""
    rows: np.ndarray
    """(T,) their numbers in the table, from 0."""
    times: np.ndarray
    """(T,) float64 seconds."""
    poses: np.ndarray
    """(T, 4, 4) float64, metres, before calibration; NaN where there are no numbers."""


@dataclass(frozen=True)
class Sweep:
    """The frames of one sweep that are sound, in order."""

    name: str
    session: str
    target: str
    times: np.ndarray
    """(T,) float64 seconds, increasing."""
    poses: np.ndarray
    """(T, 4, 4) float64, metres, calibrated."""
    wrench: np.ndarray | None
    """(T, 6) N and N·m, or None."""
    controls: np.ndarray
    """(T, 6) float32 m/s and rad/s, NaN where unknown."""
    views: np.ndarray
    """(T,) int64 labels, -1 where unknown."""
    grades: np.ndarray
    """(T,) float32, NaN where unknown."""
    images: np.ndarray
    """(T,) int64 places in the stack, increasing."""
    stack: Stack

    def part(self, chosen: np.ndarray) -> "Sweep":
        """Return the sweep with some of its frames."""
        columns = {name: getattr(self, name)[chosen] for name in _COLUMNS}
        wrench = None if self.wrench is None else self.wrench[chosen]
        return replace(self, wrench=wrench, **columns)


_COLUMNS = ("times", "poses", "controls", "views", "grades", "images")


def read_drafts(folder: Folder, mapping: Mapping) -> list[Draft]:
    """Read the tables of a mapping, and part their rows into sweeps.

    Raises:
        RacinesError: a file or a column is missing or holds something else, or two sweeps have one
            name.
    """
    poses, drafts = mapping.poses, []
    files = folder.match(poses.file, "poses.file")
    for path in files:
        table = read_table(path, poses.separator, poses.decimal_comma, poses.records)
        for text, rows in _groups(table, poses.sweep, path):
            own = table[rows]
            named = text if poses.sweep is not None else path.stem
            name = slug(named if len(files) == 1 or poses.sweep is None else f"{path.stem}-{text}")
            times = read_times(own, poses.time, "poses.time", path)
            matrices = read_poses(own, poses, path)
            drafts.append(Draft(name, named, path, own, rows, times, matrices))
    twice = [name for name, count in Counter(draft.name for draft in drafts).items() if count > 1]
    if twice:
        raise RacinesError(
            f"poses: two sweeps are called {twice[0]!r}: rename a file, or a sweep in the table"
        )
    return drafts


def slug(text: str) -> str:
    """Return text as part of a file's name."""
    return re.sub(r"[^\w.-]+", "-", text, flags=re.ASCII).strip("-.") or "sweep"


def _groups(table: pl.DataFrame, name: str | None, path: Path) -> Iterator[tuple[str, np.ndarray]]:
    if name is None:
        yield "", np.arange(len(table))
        return
    values = texts(table, name, "poses.sweep", path)
    if "" in values:
        row = values.index("")
        raise RacinesError(f"{path}: poses.sweep: row {row} names no sweep in column {name!r}")
    numbers = np.array(values)
    for text in dict.fromkeys(values):
        yield text, np.flatnonzero(numbers == text)


def read_sweep(folder: Folder, mapping: Mapping, draft: Draft, report: Report) -> Sweep | None:
    """Return what is sound of a sweep, each frame with its image; None where nothing is.

    Raises:
        RacinesError: images and rows do not go together, or the file of images cannot be used.
    """
    stack, images, faults = open_images(folder, mapping, draft.path, draft.text, draft.table)
    labelled = read_labels(draft.table, mapping, draft.path)
    wrench = read_wrench(draft.table, mapping, draft.path)
    place = folder.name(draft.path)
    sound = _sound_rows(mapping, draft, report, place)
    poses = calibrate(draft.poses[sound], mapping.calibration, mapping.poses.invert)
    if mapping.images.clock is None:
        for row in sound[[row in faults for row in sound.tolist()]].tolist():
            report.refuse(Kind.MISSING_IMAGE, place, faults[row], f"row {draft.rows[row]}")
        kept = np.array([row not in faults for row in sound], bool)
        rows, times, poses = sound[kept], draft.times[sound][kept], poses[kept]
        places = images[rows]
    else:
        rows, times, poses, places = _matched(mapping, draft, stack, sound, poses, report, folder)
    made = Sweep(
        draft.name,
        slug(labelled.session or draft.path.stem),
        labelled.target,
        times,
        poses,
        None if wrench is None else wrench[rows],
        read_controls(draft.table, mapping, draft.path)[rows],
        labelled.views[rows],
        labelled.grades[rows],
        places,
        stack,
    )
    made = _sound_images(mapping, made, report, folder)
    return made if len(made.times) else None


def _sound_rows(mapping: Mapping, draft: Draft, report: Report, place: str) -> np.ndarray:
    """Return the rows whose pose is rigid and whose time goes on; report the others."""
    own = mapping.images.clock is None
    tell = report.refuse if own else report.flag
    faults = rotation_faults(draft.poses, mapping.poses.tolerance, "pose")
    for row in np.flatnonzero(~np.isfinite(draft.times)):
        tell(Kind.NAN, place, "the row has no time", f"row {draft.rows[row]}")
    good = np.isfinite(draft.times)
    for row, fault in enumerate(faults):
        if fault is not None and good[row]:
            tell(fault.kind, place, fault.detail, f"row {draft.rows[row]}")
            good[row] = False
    kept = np.flatnonzero(good)
    lost = set(backward(draft.times[kept].tolist(), False))
    for index in sorted(lost):
        row = kept[index]
        detail = f"{draft.times[row]:.6f} s does not go on from its neighbours: sort the rows"
        tell(Kind.CLOCK, place, detail, f"row {draft.rows[row]}")
    return np.array([row for index, row in enumerate(kept) if index not in lost], int)


def _matched(
    mapping: Mapping,
    draft: Draft,
    stack: Stack,
    sound: np.ndarray,
    poses: np.ndarray,
    report: Report,
    folder: Folder,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return nearest rows, times, poses and places of the images that find a pose."""
    times = own_clock(folder, mapping, draft.text, len(stack))
    if not len(sound):
        return sound, times[:0], poses[:0], sound
    found = match(draft.times[sound], poses, times, mapping.match)
    far = np.isnan(found.poses[:, 0, 0])
    if far.all():
        first, last = draft.times[sound[[0, -1]]]
        apart = times[-1] + mapping.match.offset < first or times[0] + mapping.match.offset > last
        remedy = f"if both began together, match.offset is {first - times[0]:.6g}"
        if not apart:
            remedy = f"rows are {np.median(np.diff(draft.times[sound])):.3g} s apart: raise max_gap"
        raise RacinesError(
            f"images.clock: sweep {draft.name}: no image lies within match.max_gap "
            f"({mapping.match.max_gap:g} s) of a pose: images run from {times[0]:.6g} to "
            f"{times[-1]:.6g} s, poses from {first:.6g} to {last:.6g} s: {remedy}"
        )
    lost = set(backward(times.tolist(), False))
    for index in range(len(times)):
        if index in lost:
            detail = f"{times[index]:.6f} s does not go on from its neighbours"
            report.refuse(Kind.CLOCK, folder.name(stack.files[0]), detail, f"image {index}")
        elif far[index]:
            detail = f"the nearest pose is {found.gaps[index]:.3g} s away: beyond match.max_gap"
            report.refuse(Kind.CLOCK, folder.name(stack.files[0]), detail, f"image {index}")
    kept = np.array([i for i in np.flatnonzero(~far) if i not in lost], int)
    return sound[found.nearest[kept]], times[kept], found.poses[kept], kept


def _sound_images(mapping: Mapping, sweep: Sweep, report: Report, folder: Folder) -> Sweep:
    """Return the sweep without the frames whose image is damaged or of another size."""
    sizes, faults = sweep.stack.check()
    known = Counter(sizes[i] for i in sweep.images if faults[i] is None and sizes[i] != (0, 0))
    usual = max(known, key=lambda size: (known[size], size), default=(0, 0))
    if known:
        check_region(mapping.images, usual)
    good = np.ones(len(sweep.images), bool)
    for number, place in enumerate(sweep.images):
        file = image_name(sweep.stack, int(place), folder)
        if (fault := faults[place]) is not None:
            report.refuse(fault.kind, file, fault.detail, f"image {place}")
        elif sizes[place] != usual:
            others = f"{known[usual]} others are {resolution(usual)}"
            report.refuse(Kind.MIXED_SIZES, file, f"{resolution(sizes[place])}, {others}")
        else:
            continue
        good[number] = False
    return sweep.part(np.flatnonzero(good))


def image_name(stack: Stack, place: int, folder: Folder) -> str:
    """Return the name of the file that holds an image."""
    paths = getattr(stack, "paths", None) or [stack.files[0]] * (place + 1)
    return folder.name(paths[place] or stack.files[0])
