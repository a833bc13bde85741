"""Records of the dataset: the columns, their units, and their Arrow and Hugging Face types."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from racines_data.errors import RacinesError
from racines_data.views import LABELS

if TYPE_CHECKING:  # what starts a process (a worker, a command) need not wait for the library
    from datasets import Features

PARAMETERS = tuple(
    f"{kind}_{axis}" for kind in ("force", "torque", "position", "rotation") for axis in "xyz"
)
"""The twelve conditioning parameters: N, N·m, m, rad; robot base frame."""

CONTROLS = ("control_x", "control_y", "control_z", "control_rx", "control_ry", "control_rz")
"""Commanded velocity: m/s and rad/s; nullable."""

PHASES = ("cardiac_phase", "respiratory_phase")
"""Where a patient's heart and chest are in beat and breath, in [0, 1)."""

TURNS = ("turn_angle", "train_angle")
"""Of a rotation about the apex: the turn's angle, in [0, 180), and that to the nearest turn of the
train split, degrees. Planes half a turn apart are one plane, mirrored."""

SPLITS = ("train", "validation", "test")
SOURCES = ("phantom", "release", "cactus", "tracked")


def frame_features(
    sources: Sequence[str] = SOURCES,
    labels: Sequence[str] = LABELS,
    patients: bool = False,
    turned: bool = False,
) -> "Features":
    """Return the features of `frames`; `sources` and `labels` name the classes of source, view.

    With `patients`, those of simulated patients, who have four more; `turned`, those of a rotation
    about the apex, which have the phase of the beat and two angles.
    """
    from datasets import ClassLabel, Features, Image, Value

    columns = {"image": Image(mode="L")}
    columns |= {name: Value("float32") for name in (*PARAMETERS, "timestamp", *CONTROLS)}
    columns["timestamp"] = Value("float64")
    columns |= {
        "view": ClassLabel(names=list(labels)),
        "grade": Value("float32"),
        "view_predicted": ClassLabel(names=list(labels)),
        "grade_predicted": Value("float32"),
        "target_view": Value("string"),
        "phantom": Value("int32"),
        "source": ClassLabel(names=list(sources)),
        "session": Value("string"),
        "trajectory": Value("string"),
        "frame": Value("int32"),
    }
    if patients:
        columns |= {"patient": Value("int64"), **dict.fromkeys(PHASES, Value("float64"))}
        columns |= {"mask": Image(mode="L")}
    if turned:
        columns |= dict.fromkeys((PHASES[0], *TURNS), Value("float64"))
    return Features(columns)


def trajectory_features() -> "Features":
    """Return the features of the `trajectories` config."""
    from datasets import Features, Value

    kinds = dict.fromkeys(("trajectory", "session", "target_view"), "string")
    kinds |= {"phantom": "int32", "split": "string", "frames": "int32", "duration": "float64"}
    return Features({name: Value(kind) for name, kind in (kinds | {"digest": "string"}).items()})


@dataclass(frozen=True)
class Trajectory:
    """One recorded sweep of T frames; absent measurements are NaN (or label -1)."""

    id: str
    session: str
    target_view: str
    """One of the views, or `Random`."""
    images: np.ndarray
    """(T, 128, 128) uint8."""
    parameters: np.ndarray
    """(T, 12) float32; forces may be NaN."""
    timestamps: np.ndarray
    """(T,) float64 seconds, increasing; NaN where there is no clock."""
    controls: np.ndarray
    """(T, 6) float32; NaN where unknown."""
    views: np.ndarray
    """(T,) int64 labels; -1 where unknown."""
    grades: np.ndarray
    """(T,) float32, 0-10; NaN where unknown."""
    phantom: int | None = None
    """Seed of the simulated anatomy, 0 the canonical one; absent for recordings."""
    patient: int | None = None
    """Seed of the simulated patient; absent where none is scanned."""
    phases: np.ndarray | None = None
    """(T, 2) float64 cardiac and respiratory phase in [0, 1), of a patient; of a rotation about the
    apex the second is NaN."""
    masks: np.ndarray | None = None
    """(T, 128, 128) uint8 labels of what each pixel shows, where there are any."""
    turns: np.ndarray | None = None
    """(T, 2) float64 degrees, as `TURNS`, of a rotation about the apex."""

    def __post_init__(self) -> None:
        """Check that every column has one entry a frame."""
        columns = "parameters", "timestamps", "controls", "views", "grades"
        for name in (*columns, "phases", "masks", "turns"):
            column = getattr(self, name)
            if column is not None and len(column) != len(self.images):
                raise RacinesError(
                    f"trajectory {self.id}: {name} has {len(column)} rows for "
                    f"{len(self.images)} images"
                )

    def __len__(self) -> int:
        return len(self.images)
