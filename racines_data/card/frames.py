"""What a card draws and counts: the columns of a training store that is not yet sealed.

The figures are those of the twelve parameters, and shares of classes and grades by split.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import METADATA, manifest_labels
from racines_data.schema import CONTROLS, PARAMETERS, SPLITS
from racines_data.sources.card import manifest_card
from racines_data.views import LABELS

CACTUS_COUNTS = {"A4C": 7422, "SC": 6345, "PL": 6102, "PSAV": 5832, "PSMV": 6014, "Random": 6021}
"""Images of each class in CACTUS (DOI 10.20383/103.01484), recorded on the same kind of block."""

GRADE_EDGES = np.array([0.0, *np.arange(0.5, 10.0), 10.001])
"""Bins of grades: half a grade to each side of 0, 1, … 10."""


def has_paper(manifest: Mapping[str, Any]) -> bool:
    """Return whether the paper's statistics are the measure of this dataset: a heart with poses."""
    return manifest_card(manifest).like_paper and manifest_labels(manifest) == LABELS


def unit_of(parameter: str) -> str:
    """Return the SI unit of a parameter."""
    units = {"force": "N", "torque": "N·m", "position": "m", "rotation": "rad"}
    return units[parameter.partition("_")[0]]


@dataclass(frozen=True)
class Frames:
    """The N frames of one store, in the order train, validation, test; images memory-mapped."""

    images: np.ndarray
    """(N, 128, 128) uint8."""
    parameters: np.ndarray
    """(N, 12) float32, SI; NaN where absent."""
    controls: np.ndarray
    """(N, 6) float32, NaN where absent."""
    views: np.ndarray
    """(N,) int64 labels, -1 where unknown."""
    grades: np.ndarray
    """(N,) float32, NaN where unknown."""
    timestamps: np.ndarray
    """(N,) float64 seconds."""
    trajectory: np.ndarray
    """(N,) int64 place in `trajectories`."""
    trajectories: list[str]
    target_views: list[str]
    """Target view of each trajectory."""
    phantoms: list[int | None]
    """Seed of each trajectory's anatomy; absent for recordings."""
    splits: dict[str, tuple[int, int]]
    """First and past-the-last row of each split."""
    labels: tuple[str, ...]
    """Names of the view labels."""

    @property
    def has_poses(self) -> bool:
        """Whether any frame has a position."""
        return bool(np.isfinite(self.parameters[:, 6:9]).any())

    def rows_of(self, trajectory: int) -> slice:
        """Return the rows of one trajectory; they are neighbours."""
        low, high = np.searchsorted(self.trajectory, (trajectory, trajectory + 1))
        return slice(int(low), int(high))


def read_frames(path: Path, manifest: Mapping[str, Any]) -> Frames:
    """Map a store by its path, whatever the manifest says of its files."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    named = json.loads(table.schema.metadata[METADATA])
    trajectories, _, target_views = named["trajectories"][:3]

    def column(name: str, dtype: type, *shape: int) -> np.ndarray:
        array = table[name].chunk(0)
        buffer = (array.values if pa.types.is_fixed_size_list(array.type) else array).buffers()[1]
        flat = np.frombuffer(buffer, dtype, len(array) * int(np.prod(shape, initial=1)))
        return flat.reshape(len(array), *shape)

    return Frames(
        images=column("image", np.uint8, IMAGE_SIZE, IMAGE_SIZE),
        parameters=column("parameters", np.float32, len(PARAMETERS)),
        controls=column("controls", np.float32, len(CONTROLS)),
        views=column("view", np.int64),
        grades=column("grade", np.float32),
        timestamps=column("timestamp", np.float64),
        trajectory=column("trajectory", np.int64),
        trajectories=list(trajectories),
        target_views=list(target_views),
        phantoms=list(named.get("phantoms") or [None] * len(trajectories)),
        splits={name: tuple(named["splits"][name]) for name in SPLITS if name in named["splits"]},
        labels=manifest_labels(manifest),
    )


def card_statistics(frames: Frames) -> dict[str, Any]:
    """Return what the manifest keeps for the card; JSON-able.

    Returns:
        `parameters`: minimum, maximum, mean, std of each parameter that was measured.
        `views`: for each split, frames of each label, and `unknown`.
        `grades`: for each split, frames of view labels by rounded grade 0-10, and `unknown`.
    """
    parameters, views, grades = {}, {}, {}
    for name, column in zip(PARAMETERS, frames.parameters.T, strict=True):
        known = column[~np.isnan(column)].astype(np.float64)
        if len(known):
            four = known.min(), known.max(), known.mean(), known.std()
            keys = ("minimum", "maximum", "mean", "std")
            parameters[name] = {k: round(float(v), 6) for k, v in zip(keys, four, strict=True)}
    for split, bounds in frames.splits.items():
        labels, graded = frames.views[slice(*bounds)], frames.grades[slice(*bounds)]
        counts = np.bincount(labels[labels >= 0], minlength=len(frames.labels))
        views[split] = dict(zip(frames.labels, counts.tolist(), strict=True))
        views[split]["unknown"] = int((labels < 0).sum())
        graded = graded[labels != len(frames.labels) - 1]  # a frame of no view has grade 0
        known = graded[~np.isnan(graded)]
        counts = np.histogram(known, GRADE_EDGES)[0].tolist()
        grades[split] = {"counts": counts, "unknown": len(graded) - len(known)}
    return {"parameters": parameters, "views": views, "grades": grades}
