"""The source `table`: a folder of tables and images, and the mapping that says what is what."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from racines_data.files import sha256_file
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import SourceCard, Unit
from racines_data.sources.folder import FolderSource, Report, parameters_of, recorded
from racines_data.sources.gate.bounds import TRACKER, Bounds
from racines_data.sources.table.doubts.find import find_doubts, refuse_doubts
from racines_data.sources.table.doubts.values import image_doubts
from racines_data.sources.table.inputs import Folder, open_folder
from racines_data.sources.table.labels import labels_of
from racines_data.sources.table.mapping import Mapping, read_mapping
from racines_data.sources.table.naming import clock_files
from racines_data.sources.table.pictures.files import Files
from racines_data.sources.table.region import finish
from racines_data.sources.table.sweeps import Draft, Sweep, read_drafts, read_sweep

MAPPING = "mapping.yaml"
"""Where a mapping is looked for in the folder if none is named."""
CARD = SourceCard(
    origin="recordings of a user, imported by a mapping",
    license="unknown",
    rights="As the recordings imported. This import adds no rights.",
    labelled=True,
    collection="Recordings of a user's own, imported from tables of poses and images by a mapping, "
    "which stands in the recipe in `manifest.json`.",
    collection_type="Direct measurement",
    annotation="Views and grades, if any, are those of the tables imported.",
    biases="As the recordings; a few sweeps of one subject are the rule.",
    limitations="Poses, units and frames are as the mapping says. Where a sweep is cut into "
    "segments, frames on both sides of a cut are neighbours in time, so scores on the splits are "
    "optimistic.",
    personal="Depends on the recordings: whoever imports sweeps of persons is answerable for "
    "consent and de-identification. Only pixels, poses, forces, times, views and grades are kept.",
    limits="What the numbers mean is what the mapping says: `recipe.settings.mapping` of "
    "`manifest.json`. Segments of one sweep stand as trajectories where it was cut.",
)


@dataclass(frozen=True)
class TableConfig:
    """What is read, by which mapping."""

    mapping: str = ""
    """The mapping; empty for mapping.yaml in the folder."""
    allow: tuple[str, ...] = ()
    """Inferences that are not held against the recording; `reading` is those of the mapping."""


@dataclass(frozen=True)
class TableUnit(Unit):
    """A sweep, or a segment of one."""

    sweep: Sweep = field(compare=False, repr=False)


@dataclass
class TableSource(FolderSource):
    """Reads a folder by a mapping."""

    name = "table"
    version = "0.1.0"
    Config = TableConfig
    card = CARD
    reader = 2
    of_users = True

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> Self:
        """Make the source; the one input is the folder.

        Raises:
            RacinesError: no input or several, no such folder, no mapping, or what is wrong with it.
        """
        made = super().from_config(config, inputs)
        labels_of(made.mapping)
        return made

    def __post_init__(self) -> None:
        """Read the mapping."""
        path = Path(self.config.mapping) if self.config.mapping else self.root / MAPPING
        self.mapping: Mapping = read_mapping(path)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the views, `Random` last."""
        return labels_of(self.mapping)

    @property
    def bounds(self) -> Bounds:
        """What is plausible of a robot's base, or of a tracker."""
        return bounds_of_mapping(self.mapping)

    def recipe(self) -> dict[str, Any]:
        """Return the reader's version, the mapping, and the sha256 over all files it names."""
        if not self._inputs:
            self.plan()
        mapping = self.mapping.model_dump(mode="json")
        return {"reader": self.reader, "mapping": mapping, "inputs": self._inputs}

    def plan(self) -> list[TableUnit]:
        """Check every row and image, and cut what is kept into segments.

        Raises:
            RacinesError: what is wrong with the mapping, with the likely cause.
        """
        folder, self.report = open_folder(self.root), Report(self.root)
        drafts = read_drafts(folder, self.mapping)
        doubts = find_doubts(self.mapping, drafts, self.bounds)
        refuse_doubts(doubts, self.config.allow, folder.name(drafts[0].path))
        sweeps = self._read(folder, drafts)
        refuse_doubts(list(image_doubts(sweeps)), self.config.allow, folder.name(drafts[0].path))
        self._inputs = _digest(folder, self.mapping, drafts, sweeps)
        return [unit for sweep in sweeps for unit in units_of(sweep, self.mapping.segments)]

    def _read(self, folder: Folder, drafts: Sequence[Draft]) -> list[Sweep]:
        assert isinstance(self.report, Report)
        found = []
        with progress_bar(self.progress) as bar:
            task = bar.add_task("rows checked", total=sum(len(draft.rows) for draft in drafts))
            for draft in drafts:
                sweep = read_sweep(folder, self.mapping, draft, self.report)
                found += [] if sweep is None else [sweep]
                bar.advance(task, len(draft.rows))
        return found

    def produce(self, unit: Unit) -> Trajectory:
        """Read a sweep: square 128×128 images, poses in metres and radians."""
        assert isinstance(unit, TableUnit)
        return produce(unit, self.mapping)


def produce(unit: TableUnit, mapping: Mapping) -> Trajectory:
    """Return the trajectory of a unit.

    Raises:
        RacinesError: an image cannot be read.
    """
    sweep, images = unit.sweep, mapping.images
    # Two rows may show one image: each is read once, in the order of the file.
    wanted = np.unique(sweep.images)
    read = zip(wanted.tolist(), sweep.stack.read(wanted.tolist()), strict=True)
    made = {place: finish(image, images, sweep.stack.orientation) for place, image in read}
    tolerance = mapping.poses.tolerance
    return recorded(
        unit,
        [made[place] for place in sweep.images.tolist()],
        parameters=parameters_of(sweep.poses, sweep.wrench, tolerance=tolerance, nearest=True),
        timestamps=sweep.times,
        controls=sweep.controls,
        views=sweep.views,
        grades=sweep.grades,
    )


def bounds_of_mapping(mapping: Mapping) -> Bounds:
    """Return what the gate holds plausible in the frame that a mapping names."""
    return TRACKER if mapping.frame == "tracker" else Bounds()


def units_of(sweep: Sweep, segments: int) -> list[TableUnit]:
    """Cut a sweep into contiguous segments of nearly equal length."""
    count = min(segments, len(sweep.times))
    cuts = np.array_split(np.arange(len(sweep.times)), count)
    units = []
    for number, chosen in enumerate(cuts):
        part, name = sweep.part(chosen), sweep.name
        if isinstance(part.stack, Files):  # a process needs the names of its own files alone
            paths = [part.stack.paths[place] for place in part.images]
            part = replace(part, stack=Files(paths), images=np.arange(len(paths)))
        names = (f"{name}-{number:02d}" if segments > 1 else name), sweep.session, sweep.target
        units.append(TableUnit(*names, len(chosen), part))
    return units


def _digest(
    folder: Folder, mapping: Mapping, drafts: Sequence[Draft], sweeps: Sequence[Sweep]
) -> str:
    """Return the sha256 over the names and bytes of all files read."""
    files = {draft.path for draft in drafts} | {path for s in sweeps for path in s.stack.files}
    files |= {path for draft in drafts for path in clock_files(folder, mapping, draft.text)}
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{folder.name(path)}\0{sha256_file(path)}\0".encode())
    return digest.hexdigest()
