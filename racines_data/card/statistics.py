"""The figures of a card: the twelve parameters, and shares of classes and grades by split."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from racines_data.card.frames import Frames
from racines_data.manifest import manifest_labels
from racines_data.schema import PARAMETERS
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
    kind = parameter.partition("_")[0]
    return {"force": "N", "torque": "N·m", "position": "m", "rotation": "rad"}[kind]


def card_statistics(frames: Frames) -> dict[str, Any]:
    """Return what the manifest keeps for the card; JSON-able.

    Returns:
        `parameters`: minimum, maximum, mean, std of each parameter that was measured.
        `views`: for each split, frames of each label, and `unknown`.
        `grades`: for each split, frames of view labels by rounded grade 0-10, and `unknown`.
    """
    splits = {name: slice(*bounds) for name, bounds in frames.splits.items()}
    return {
        "parameters": _moments(frames.parameters),
        "views": {name: _class_counts(frames, rows) for name, rows in splits.items()},
        "grades": {name: _grade_counts(frames, rows) for name, rows in splits.items()},
    }


def _moments(parameters: np.ndarray) -> dict[str, dict[str, float]]:
    found = {}
    for index, name in enumerate(PARAMETERS):
        values = parameters[:, index].astype(np.float64)
        values = values[~np.isnan(values)]
        if len(values):
            four = values.min(), values.max(), values.mean(), values.std()
            keys = ("minimum", "maximum", "mean", "std")
            found[name] = {k: round(float(v), 6) for k, v in zip(keys, four, strict=True)}
    return found


def _class_counts(frames: Frames, rows: slice) -> dict[str, int]:
    views = frames.views[rows]
    counts = np.bincount(views[views >= 0], minlength=len(frames.labels))
    named = {name: int(n) for name, n in zip(frames.labels, counts, strict=True)}
    return {**named, "unknown": int((views < 0).sum())}


def _grade_counts(frames: Frames, rows: slice) -> dict[str, Any]:
    shown = frames.views[rows] != len(frames.labels) - 1  # a frame of no view has grade 0
    grades = frames.grades[rows][shown]
    known = grades[~np.isnan(grades)]
    counts = np.histogram(known, GRADE_EDGES)[0]
    return {"counts": [int(n) for n in counts], "unknown": int(len(grades) - len(known))}
