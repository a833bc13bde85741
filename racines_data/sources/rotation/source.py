"""The source `rotation`: turns of the probe about the apex, frames of a beating heart, no forces.

A turn is a trajectory: the frames of one pose, in order of the beat. There is no clock, so that
times are absent. The probe's frame is made of the image's: x right, z along the beam, the tip at
the top middle; the world's axes stay those of the file. Positions are in metres where the size of a
pixel is given; else they stay in pixels, and the manifest says that the scale is unknown.
"""

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.manifest import UNKNOWN_SCALE
from racines_data.plotting import evenly
from racines_data.progress import progress_bar
from racines_data.schema import Trajectory
from racines_data.sources.base import SourceCard, Unit
from racines_data.sources.folder import FolderSource, Report, parameters_of, recorded
from racines_data.sources.gate.bounds import TRACKER, Bounds
from racines_data.sources.gate.numbers import TOLERANCE
from racines_data.sources.gate.pixels import sector_side
from racines_data.sources.images import Kind, read_gray, resolution, square
from racines_data.sources.rotation.pictures import check_pictures, find_pictures
from racines_data.sources.rotation.transforms import Transforms, find_transforms, read_transforms
from racines_data.sources.rotation.turns import (
    INTERPOLATION,
    MODES,
    Turn,
    angles,
    check_apex,
    group_turns,
    split_turns,
    tips,
    to_nearest,
)
from racines_data.sources.table.inputs import open_folder
from racines_data.sources.table.sweeps import slug
from racines_data.views import RANDOM

METRES = dataclasses.replace(TRACKER, nearest=0.0, clock=False, allow=("sector",))
"""Positions in metres, from a corner of the volume: the apex may lie at the origin. The sector is
looked for in all turns together: of one heart's few frames, too much may be black."""
PIXELS = dataclasses.replace(METRES, reach=1e5)
"""Positions in pixels: any."""
_LOOKED_AT = 96
"""Images, evenly spread, in which the sector is looked for."""
_COPIES = 0.5
"""Share of images that are copies of others, at most."""
_SMALLEST, _LARGEST = 0.01, 5.0
"""mm of a pixel that are plausible."""

CARD = SourceCard(
    origin="real echo of one heart, turned about the apex, imported; poses, phases, no forces",
    license="unknown",
    rights="As the recordings imported. This import adds no rights.",
    labelled=False,
    collection="Frames of a probe that is turned about the apex, imported from images and one file "
    "of poses. A turn is a trajectory: the frames of one pose, in order of the beat, with their "
    "`cardiac_phase`. There are no times, forces, views or grades.",
    collection_type="Direct measurement",
    annotation="None: there are no views and no grades. Poses are the file's; where the file gives "
    "no phases, the frames of one pose are taken to be evenly spread over a beat.",
    biases="As the recordings; one heart of one person is the rule.",
    limitations="One heart: nothing is known of another. Poses may be estimates, and so is the "
    "scale of what has no size of a pixel. Turns cluster, so that held-out frames have neighbours "
    "in training: `train_angle` says how near.",
    personal="Depends on the recordings: whoever imports frames of persons is answerable for "
    "consent and de-identification. Only pixels, poses and phases are kept.",
    limits="One heart. Splits are by angle of the turn, modulo 180°; each frame has its angle to "
    "the nearest training turn in `train_angle`, and results should be told by it. Positions are "
    "in pixels where the manifest says that the scale is unknown.",
)


@dataclass(frozen=True)
class RotationConfig:
    """What is read, and how turns are split."""

    pixel_mm: float | None = None
    """Size of a pixel of the recorded images, mm; None where it is not known."""
    split: str = INTERPOLATION
    """`interpolation`: several narrow blocks of turns are held out; `gap`: a wide one."""
    blocks: int = 6
    """Narrow blocks for test, of few turns fewer; half as many are for validation."""
    width: float = 3.0
    """Degrees of a narrow block."""
    gap: float = 30.0
    """Degrees of the wide one."""
    share: float = 0.2
    """Share of the turns that the wide one should hold: it lies where it comes nearest to that."""
    transforms: str = ""
    """The file of poses; empty for the only `transforms*.json`."""
    images: str = ""
    """Folder of the images where the file of poses names none that are there."""
    plane: float | None = None
    """Where the image lies along its normal in the volume, pixels; None for half of its width."""
    tolerance: float = TOLERANCE
    """Largest error of a rotation's orthonormality, per element of R Rᵀ - 1."""


@dataclass(frozen=True)
class TurnUnit(Unit):
    """The frames of one turn."""

    split: str = ""
    """The split of the turn."""
    turn: int = 0
    """Place of the turn in the file of poses, from 0."""
    paths: tuple[Path, ...] = ()
    matrix: np.ndarray = field(default_factory=lambda: np.eye(4), compare=False, repr=False)
    """(4, 4) pose of the probe, in the unit of the dataset."""
    phases: tuple[float, ...] = ()
    """Of each frame, in [0, 1); empty where a turn is one still frame."""
    at: tuple[float, float] = (0.0, 0.0)
    """Angle of the turn, and to the nearest training turn, degrees."""


@dataclass
class RotationSource(FolderSource):
    """Reads a folder of posed rotations."""

    config: RotationConfig
    told: dict[str, Any] = field(default_factory=dict, init=False)
    """What the manifest holds of it: the scale, and the turns."""
    name = "rotation"
    version = "0.1.0"
    Config = RotationConfig
    card = CARD
    of_users = True

    @classmethod
    def check_settings(cls, settings: RotationConfig) -> None:
        """Refuse a split that is none, and sizes out of range."""
        where = "data.rotation"
        if settings.split not in MODES:
            raise RacinesError(f"{where}.split {settings.split!r}: choose {' or '.join(MODES)}")
        if settings.pixel_mm is not None and not _SMALLEST <= settings.pixel_mm <= _LARGEST:
            raise RacinesError(
                f"{where}.pixel_mm {settings.pixel_mm:g}: a pixel of an echo measures "
                f"{_SMALLEST:g} to {_LARGEST:g} mm: likely another unit"
            )
        if settings.blocks < 1 or not 0 < settings.width <= 90 or not 0 < settings.gap <= 120:
            raise RacinesError(
                f"{where}: blocks are 1 or more, width in (0, 90] and gap in (0, 120] degrees"
            )
        if not 0 < settings.share < 1 or settings.tolerance <= 0:
            raise RacinesError(f"{where}: share lies in (0, 1) and tolerance is above 0")

    @property
    def bounds(self) -> Bounds:
        """What is plausible: of metres, or of pixels."""
        return PIXELS if self.config.pixel_mm is None else METRES

    @property
    def unit(self) -> float:
        """Units of the dataset's positions, metres or pixels, of a pixel."""
        return 1.0 if self.config.pixel_mm is None else 1e-3 * self.config.pixel_mm

    def plan(self) -> list[TurnUnit]:
        """Read the file of poses, find and check every image, and split the turns.

        Raises:
            RacinesError: what does not fit, with the file and the key.
        """
        folder, report = open_folder(self.root), Report(self.root)
        self.report = report
        path = find_transforms(folder, self.config.transforms)
        transforms = read_transforms(path, self.config.tolerance)
        found = find_pictures(folder, transforms, self.config.images)
        with progress_bar(self.progress) as bar:
            task = bar.add_task("images checked", total=len(found.paths))
            size = check_pictures(folder, transforms, found.paths)
            bar.advance(task, len(found.paths))
        _check_upright(found.paths)
        turns = group_turns(transforms.matrices, transforms.times, str(path))
        plane = size[0] / 2 if self.config.plane is None else self.config.plane
        poses = np.stack([turn.matrix for turn in turns])
        check_apex(poses, size, plane, str(path))
        at = angles(poses)
        config = self.config
        splits = split_turns(
            at, config.split, config.blocks, config.width, config.gap, config.share
        )
        nearest = to_nearest(at, at[splits == "train"])
        self._inputs = _digest(folder.name(path), path, found.paths)
        self._tell(path, found.said, size, turns, transforms, at, splits, nearest)
        probe = probe_poses(poses, size[0], plane, self.unit)
        session, phases = slug(self.root.name), _phases(turns, transforms)
        units = []
        for number, turn in enumerate(turns):
            names = f"turn-{number:04d}", session, RANDOM, len(turn.frames)
            own = tuple(found.paths[place] for place in turn.frames)
            told = float(at[number]), float(nearest[number])
            place = str(splits[number]), number, own, probe[number]
            units.append(TurnUnit(*names, *place, phases[number], told))
        return units

    def _tell(
        self,
        path: Path,
        said: str,
        size: tuple[int, int],
        turns: Sequence[Turn],
        transforms: Transforms,
        at: np.ndarray,
        splits: np.ndarray,
        nearest: np.ndarray,
    ) -> None:
        """Say what the manifest holds, and what a reader has to know of the import."""
        report, config, held = self.report, self.config, splits == "test"
        assert isinstance(report, Report)
        each = len(turns[0].frames)
        mm = config.pixel_mm
        known = [sorted(at[splits == name].round(2).tolist()) for name in ("test", "validation")]
        self.told = {
            "scale": UNKNOWN_SCALE if mm is None else {"pixel_mm": mm},
            "turns": {
                "count": len(turns),
                "phases": each,
                "image_pixels": list(size),
                "split": config.split,
                "test": known[0],
                "validation": known[1],
                "farthest": round(float(nearest[held].max()), 3),
                "median": round(float(np.median(nearest[held])), 3),
            },
        }
        if said:
            report.flag(Kind.ORDER, path, said, "file_path", 0)
        counts = ", ".join(
            f"{int((splits == s).sum())} {s}" for s in ("train", "validation", "test")
        )
        detail = (
            f"{len(turns)} turns of {each} phases, {resolution(size)} pixels; {config.split}: "
            f"{counts}; a test turn lies {np.median(nearest[held]):.2g}° from the nearest training "
            f"turn (median; {nearest[held].max():.2g}° at most), modulo 180°"
        )
        report.flag(Kind.SPLIT, path, detail, "frames", 0)
        if mm is None:
            detail = (
                "the size of a pixel is not given: positions stay in pixels, and nothing is told "
                "in millimetres; give it with --pixel-mm"
            )
            report.flag(Kind.SCALE, path, detail, "transform_matrix", 0)
        if each > 1 and transforms.times is None:
            detail = f"not given: the {each} frames of a turn are evenly spread over a beat"
            report.flag(Kind.PHASE, path, detail, "time", 0)

    def produce(self, unit: Unit) -> Trajectory:
        """Read a turn: square 128×128 images of one pose, phases, angles; no times, no forces."""
        assert isinstance(unit, TurnUnit)
        count = unit.frames
        poses = np.repeat(unit.matrix[None], count, 0)
        known: dict[str, np.ndarray] = {"turns": np.tile(np.array(unit.at), (count, 1))}
        if unit.phases:
            beat = np.array(unit.phases)
            known["phases"] = np.stack([beat, np.full(count, np.nan)], -1)
        known["parameters"] = parameters_of(poses, tolerance=self.config.tolerance)
        return recorded(unit, [square(read_gray(path)) for path in unit.paths], **known)


def probe_poses(matrices: np.ndarray, width: float, plane: float, unit: float) -> np.ndarray:
    """Return the (N, 4, 4) poses of the probe, in `unit`s of a pixel, of (N, 4, 4) of the image.

    x is the image's, z its depth, y completes a right-handed frame; the tip is the top middle.
    """
    poses = np.tile(np.eye(4), (len(matrices), 1, 1))
    across, depth, normal = (matrices[:, :3, axis] for axis in range(3))
    poses[:, :3, :3] = np.stack([across, -normal, depth], -1)
    poses[:, :3, 3] = unit * tips(matrices, width, plane)
    return poses


def _phases(turns: Sequence[Turn], transforms: Transforms) -> list[tuple[float, ...]]:
    """Return the phases of each turn's frames; none where a turn is one frame and none is given."""
    if transforms.times is not None:
        return [tuple(transforms.times[turn.frames].tolist()) for turn in turns]
    count = len(turns[0].frames)
    return [() if count == 1 else tuple(k / count for k in range(count)) for _ in turns]


def _check_upright(paths: Sequence[Path]) -> None:
    """Refuse images whose sector's tip, where one is to be seen, is not at the top.

    Raises:
        RacinesError: the side at which it is.
    """
    some = [paths[place] for place in evenly(len(paths), _LOOKED_AT)]
    side = sector_side(np.stack([square(read_gray(path)) for path in some]))
    if side not in ("", "top"):
        raise RacinesError(
            f"{paths[0]}: {Kind.TURNED}: the sector's tip is at the {side} in all images: give "
            "them with the probe at the top centre"
        )


def _digest(name: str, path: Path, pictures: Sequence[Path]) -> str:
    """Return the sha256 over the bytes of the file of poses and of the images in its order.

    Raises:
        RacinesError: most images are copies of others.
    """
    digest = hashlib.sha256(f"{name}\0{sha256_file(path)}\0".encode())
    each = [sha256_file(picture) for picture in pictures]
    copies = len(each) - len(set(each))
    if copies > _COPIES * len(each):
        raise RacinesError(
            f"{pictures[0]}: {Kind.FROZEN}: {copies} of {len(each)} images are the bytes of "
            "another: give each frame its own"
        )
    digest.update("".join(each).encode())
    return digest.hexdigest()
