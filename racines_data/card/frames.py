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
from racines_data.records import PIXELS
from racines_data.schema import PARAMETERS, SPLITS
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
    """The N frames of one store, in the order train, validation, test; images memory-mapped.

    What is absent or unknown is NaN, and -1 among the views.
    """

    images: np.ndarray
    """(N, 128, 128) uint8."""
    parameters: np.ndarray
    """(N, 12) float32, SI."""
    views: np.ndarray
    """(N,) int64 labels."""
    grades: np.ndarray
    timestamps: np.ndarray
    """(N,) float64 seconds."""
    trajectory: np.ndarray
    """(N,) int64 place in `target_views`."""
    target_views: list[str]
    """Target view of each trajectory."""
    phantoms: list[int | None]
    """Seed of each trajectory's anatomy; absent for recordings."""
    splits: dict[str, tuple[int, int]]
    """First and past-the-last row of each split."""
    labels: tuple[str, ...]

    def rows_of(self, trajectory: int) -> slice:
        """Return the rows of one trajectory; they are neighbours."""
        low, high = np.searchsorted(self.trajectory, (trajectory, trajectory + 1))
        return slice(int(low), int(high))


def read_frames(path: Path, manifest: Mapping[str, Any]) -> Frames:
    """Map a store by its path, whatever the manifest says of its files."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    named = json.loads(table.schema.metadata[METADATA])
    target_views = list(named["trajectories"][2])
    pixels = np.frombuffer(table["image"].chunk(0).buffers()[1], np.uint8, len(table) * PIXELS)
    parameters = table["parameters"].chunk(0).flatten().to_numpy()
    return Frames(
        images=pixels.reshape(-1, IMAGE_SIZE, IMAGE_SIZE),
        parameters=parameters.reshape(-1, len(PARAMETERS)),
        views=table["view"].to_numpy(),
        grades=table["grade"].to_numpy(),
        timestamps=table["timestamp"].to_numpy(),
        trajectory=table["trajectory"].to_numpy(),
        target_views=target_views,
        phantoms=list(named.get("phantoms") or [None] * len(target_views)),
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
