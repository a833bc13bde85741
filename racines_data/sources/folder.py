"""What readers of recordings share: a folder of files, the report on it, poses, trajectories."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.schema import CONTROLS, PARAMETERS, Trajectory
from racines_data.sources.base import Finding, Unit
from racines_data.sources.gate.numbers import LENGTHS, TOLERANCE, check_poses
from racines_data.sources.images import Kind

UNITS = {name: LENGTHS[name] for name in ("m", "mm")}
"""Metres of each unit that a recording may be read in."""


class Report(list[Finding]):
    """The findings of an import; files are named relative to its folder."""

    def __init__(self, root: Path) -> None:
        super().__init__()
        self.root = root

    def place(self, file: Path | str) -> str:
        """Return how a file is named."""
        return file if isinstance(file, str) else file.relative_to(self.root).as_posix()

    def refuse(
        self, kind: Kind, file: Path | str, detail: str, item: str = "", frames: int = 1
    ) -> None:
        """Add what costs frames."""
        self.append(Finding(self.place(file), item, True, f"{kind}: {detail}", frames))

    def flag(
        self, kind: Kind, file: Path | str, detail: str, item: str = "", frames: int = 1
    ) -> None:
        """Add what is said of frames that are kept."""
        self.append(Finding(self.place(file), item, False, f"{kind}: {detail}", frames))


def count_kinds(report: Sequence[Finding]) -> dict[str, int]:
    """Return the number of findings of each kind, in order of first appearance."""
    return dict(Counter(finding.reason.partition(":")[0] for finding in report))


@dataclass
class FolderSource:
    """The part of a source's protocol that is the same for every folder."""

    config: Any
    root: Path
    report: list[Finding] = field(default_factory=list)
    progress: bool = False
    """Show a progress bar on stderr while the files are checked."""
    _inputs: str = field(default="", init=False)
    """The sha256 over all files, which `plan` finds."""
    name = ""
    Config: ClassVar[type]
    reader: ClassVar[int] = 1
    """Version of what the reader makes of the files; part of the recipe."""

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> Self:
        """Make the source; the one input is the folder.

        Raises:
            RacinesError: no input or several, no such folder, or a wrong setting.
        """
        settings = fill(cls.Config, config, f"data.{cls.name}")
        cls.check_settings(settings)
        if len(inputs) != 1:
            raise RacinesError(f"source {cls.name}: name one folder: --input FOLDER")
        if not inputs[0].is_dir():
            raise RacinesError(f"{inputs[0]}: no such folder")
        return cls(settings, inputs[0].resolve())

    @classmethod
    def check_settings(cls, settings: Any) -> None:
        """Refuse settings whose values do not fit, by `RacinesError`."""

    def recipe(self) -> dict[str, Any]:
        """Return the reader's version, the settings, and the sha256 over all files."""
        if not self._inputs:
            self.plan()
        config = dataclasses.asdict(self.config)
        return {"reader": self.reader, "config": config, "inputs": self._inputs}

    def plan(self) -> Sequence[Unit]:
        """Check every file, set the hash over all, and return the units; see `Source`."""
        raise NotImplementedError


def parameters_of(
    matrices: np.ndarray,
    wrench: np.ndarray | None = None,
    metres: float = 1.0,
    tolerance: float = TOLERANCE,
    nearest: bool = False,
) -> np.ndarray:
    """Return (T, 12) float32 parameters of (T, 4, 4) poses and (T, 6) forces and torques, float64.

    Positions come in units of so many `metres`; without a wrench, forces are NaN. A rotation may be
    off by `tolerance`, per element of R Rᵀ - 1. Angles are read from some of its elements; with
    `nearest` from the nearest rotation's, so that a rounded matrix and its quaternion agree.

    Raises:
        RacinesError: a matrix that is no rigid right-handed pose: angles would hide that.
    """
    check_poses(matrices, tolerance)
    rotations = nearest_rotations(matrices[:, :3, :3]) if nearest else matrices[:, :3, :3]
    pose = Pose(torch.from_numpy(matrices[:, :3, 3] * metres), torch.from_numpy(rotations))
    forces = np.full((len(matrices), 6), np.nan) if wrench is None else wrench
    return pose_to_parameters(pose, torch.from_numpy(forces)).to(torch.float32).numpy()


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the rotations nearest to (T, 3, 3) right-handed matrices: their polar factors.

    Source: Higham, Computing the polar decomposition, 1986.
    """
    left, _, right = np.linalg.svd(matrices)
    return left @ right


def recorded(unit: Unit, images: Sequence[np.ndarray], **known: np.ndarray) -> Trajectory:
    """Return a unit's trajectory: (128, 128) images, the columns known, and the others absent."""
    count = len(images)
    absent = {
        "parameters": np.full((count, len(PARAMETERS)), np.nan, np.float32),
        "timestamps": np.full(count, np.nan),
        "controls": np.full((count, len(CONTROLS)), np.nan, np.float32),
        "views": np.full(count, -1),
        "grades": np.full(count, np.nan, np.float32),
    }
    columns = {**absent, **known}
    return Trajectory(unit.id, unit.session, unit.target_view, np.stack(images), **columns)
