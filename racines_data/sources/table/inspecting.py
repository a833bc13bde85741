"""A mapping tried on its folder, whatever is wrong: what would be imported, and what not."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError
from racines_data.plotting import evenly
from racines_data.sources.folder import Report
from racines_data.sources.gate.check import check_trajectory
from racines_data.sources.table.doubts.base import Doubt
from racines_data.sources.table.doubts.find import find_doubts
from racines_data.sources.table.doubts.values import image_doubts
from racines_data.sources.table.inputs import open_folder
from racines_data.sources.table.labels import labels_of
from racines_data.sources.table.mapping import Mapping
from racines_data.sources.table.poses import calibrate
from racines_data.sources.table.region import finish
from racines_data.sources.table.source import bounds_of_mapping, produce, units_of
from racines_data.sources.table.sweeps import Draft, Sweep, read_drafts, read_sweep

SHOWN = 6
"""Frames on the sheet."""
_HELD = 500
"""Frames of a sweep that the gate looks at here, at most."""


@dataclass
class Inspection:
    """What a mapping makes of a folder."""

    drafts: list[Draft]
    poses: list[np.ndarray]
    """(T, 4, 4) of each draft, metres, calibrated; not rigid where the mapping is wrong."""
    doubts: list[Doubt]
    imaged: bool = True
    """Whether the axes are those of the image, and not of a marker on the probe."""
    refused: list[str] = field(default_factory=list)
    """What the import would stop at, beside doubts."""
    report: Report | None = None
    sweeps: list[Sweep] = field(default_factory=list)
    images: list[tuple[str, np.ndarray]] = field(default_factory=list)
    """Titles and (128, 128) uint8 of some frames of the first sweep."""
    unit: str = "mm"
    """Of positions, of which there are a thousand to the unit of `poses`."""

    @property
    def frames(self) -> int:
        """Number of frames that are sound."""
        return sum(len(sweep.times) for sweep in self.sweeps)

    def words(self) -> list[str]:
        """Return what looks wrong, a line each, what stops the import first."""
        told = [str(doubt) for doubt in self.doubts] + self.refused
        lost = [each for each in self.report or () if each.refused]
        told += [f"refused: {each.file} {each.item}: {each.reason}" for each in lost[:3]]
        return told + ([f"… and {len(lost) - 3} more refused"] if len(lost) > 3 else [])


def inspect_mapping(root: Path, mapping: Mapping, allow: Sequence[str] = ()) -> Inspection:
    """Return what a mapping makes of a folder; what is wrong is collected, not raised.

    Raises:
        RacinesError: the tables cannot be read at all.
    """
    folder, bounds = open_folder(root), bounds_of_mapping(mapping)
    drafts = read_drafts(folder, mapping)
    doubts = find_doubts(mapping, drafts, bounds)
    imaged = mapping.frame == "robot" or mapping.calibration.image_to_probe is not None
    made = Inspection(drafts, [], doubts, imaged, report=Report(folder.root))
    for draft in drafts:
        made.poses.append(_calibrated(draft, mapping, made))
    for draft in drafts:
        assert made.report is not None
        try:
            sweep = read_sweep(folder, mapping, draft, made.report)
        except RacinesError as error:
            made.refused.append(str(error))
            break
        made.sweeps += [] if sweep is None else [sweep]
    made.doubts += image_doubts(made.sweeps)
    _gate(made, mapping, allow)
    if made.sweeps:
        made.images = _frames(made.sweeps[0], mapping, made)
    return made


def _calibrated(draft: Draft, mapping: Mapping, made: Inspection) -> np.ndarray:
    try:
        return calibrate(draft.poses, mapping.calibration, mapping.poses.invert)
    except RacinesError as error:
        if str(error) not in made.refused:
            made.refused.append(str(error))
        return draft.poses


def _gate(made: Inspection, mapping: Mapping, allow: Sequence[str]) -> None:
    """Hold the first sweep against the gate that every trajectory passes."""
    bounds = bounds_of_mapping(mapping)
    allowed = type(bounds)(**{**vars(bounds), "allow": tuple(allow)})
    for sweep in made.sweeps[:1]:
        part = sweep.part(np.arange(min(len(sweep.times), _HELD)))
        for unit in units_of(part, 1):
            try:
                trajectory = produce(unit, mapping)
                check_trajectory(trajectory, unit, labels_of(mapping), True, allowed, "table")
            except RacinesError as error:
                made.refused.append(str(error))


def _frames(sweep: Sweep, mapping: Mapping, made: Inspection) -> list[tuple[str, np.ndarray]]:
    chosen = evenly(len(sweep.images), SHOWN)
    places = np.unique(sweep.images[chosen])
    try:
        read = sweep.stack.read(places.tolist())
        images = [finish(each, mapping.images, sweep.stack.orientation) for each in read]
    except RacinesError as error:
        if str(error) not in made.refused:
            made.refused.append(str(error))
        return []
    first = sweep.times[0]
    names = [f"{t - first:.2f} s" for t in sweep.times[chosen]]
    return list(zip(names, images, strict=False))
