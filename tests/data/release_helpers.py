"""What the tests of the release importer share: the small tree's places, and ways to change it."""

from pathlib import Path

import numpy as np

from racines_data.sources.base import Finding
from racines_data.sources.release.layout import parse_log
from racines_data.sources.release.source import ReleaseSource
from tests.data.release_tree import FRAMES, log_text

IMAGES, LOGS = "Folder 1/A4C/images", "Folder 1/A4C/logs"
TOTAL = 5 * FRAMES


def source(root: Path, **settings) -> ReleaseSource:
    return ReleaseSource.from_config(settings, [root])


def planned(root: Path, **settings) -> tuple[int, list[Finding]]:
    made = source(root, **settings)
    return sum(unit.frames for unit in made.plan()), made.report


def change(root: Path, number: int, **parts) -> None:
    """Replace parts of a log of the first recording."""
    path = root / LOGS / f"PA_{number}.txt"
    row = np.array(parse_log(path.read_text()))
    fields = {"time": row[0], "wrench": row[1:7], "pose": row[7:23].reshape(4, 4)}
    fields |= {"control": row[23:29]}
    path.write_text(log_text(**(fields | parts)))


def pose_of(root: Path, number: int) -> np.ndarray:
    text = (root / LOGS / f"PA_{number}.txt").read_text()
    return np.array(parse_log(text))[7:23].reshape(4, 4)
