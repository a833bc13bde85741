"""What a grader calls real frames: A4C frames, the same ones spoilt, other views, turned planes."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_models.protocol import Judge
from racines_models.statistics import mean_interval, rate_interval, wilson
from racines_models.studies.sim_to_real.controls import CONTROLS
from racines_models.studies.sim_to_real.frames import VIEW, Frames, Pictures, Rotation

BIN = 15.0
"""Width of the bins of a turn, degrees."""
SECTORS = {"A4C": (0.0, 15.0), "between": (45.0, 135.0), "A4C mirrored": (165.0, 180.0)}
"""Turns either way from A4C that are summed up: between them lie A2C, A3C and no named view."""
SURE = 0.9
"""Probability of a view from which a frame counts as sure to show it, as in the tasks' success."""

Advance = Callable[[int], None]


class Called(NamedTuple):
    """What N frames are called."""

    label: np.ndarray
    """(N,) int64."""
    probability: np.ndarray
    """(N,) float32, of A4C."""


def call(judge: Judge, images: Tensor, advance: Advance | None = None) -> Called:
    """Ask a judge about (N, 128, 128) uint8 frames.

    Raises:
        RacinesError: it does not know the view.
    """
    if VIEW not in judge.labels:
        known = ", ".join(judge.labels)
        raise RacinesError(f"the grader knows {known}, not {VIEW}: name one of hearts (--grader)")
    parts = []
    for batch in images.split(256):
        parts.append(judge.probabilities_and_grade(batch)[0].float().cpu())
        if advance is not None:
            advance(len(batch))
    probabilities = torch.cat(parts)
    of_view = probabilities[:, judge.labels.index(VIEW)]
    return Called(probabilities.argmax(1).numpy(), of_view.numpy())


def call_controls(
    judge: Judge, frames: Frames, advance: Advance | None = None
) -> dict[str, Called]:
    """Ask about the frames as they are and in each way that they are spoilt."""
    return {name: call(judge, show(frames.images), advance) for name, show in CONTROLS.items()}


def accepted(
    called: Mapping[str, Called], patient: np.ndarray, rows: np.ndarray, labels: tuple[str, ...]
) -> dict[str, Any]:
    """Return by control the share of some frames (surely) called A4C, and what others are called.

    Args:
        called: by control.
        patient: (N,) ids, the units of intervals.
        rows: (n,) of the N frames.
        labels: of the judge.
    """
    told = {}
    for name, each in called.items():
        label, who = each.label[rows], patient[rows]
        told[name] = {
            "called_a4c": rate_interval(label == labels.index(VIEW), who).to_json(),
            "surely_a4c": rate_interval(each.probability[rows] >= np.float32(SURE), who).to_json(),
            "probability": mean_interval(each.probability[rows], who, 0.0, 1.0).to_json(),
            "called": _counted(label, labels),
        }
    return told


def _counted(label: np.ndarray, labels: tuple[str, ...]) -> dict[str, int]:
    return {name: int((label == place).sum()) for place, name in enumerate(labels)}


def accepted_pictures(
    called: Called, pictures: Pictures, labels: tuple[str, ...]
) -> dict[str, Any]:
    """Return what each single picture is called, and the share of other views called A4C."""
    other = np.array([view != VIEW for view in pictures.views])
    hits = called.label[other] == labels.index(VIEW)
    rows = zip(pictures.names, pictures.views, called.label, called.probability, strict=True)
    return {
        "others_called_a4c": wilson(hits),
        "pictures": [
            {"file": file, "view": view, "called": labels[label], "probability": float(p)}
            for file, view, label, p in rows
        ],
    }


def accepted_turns(called: Called, rotation: Rotation, labels: tuple[str, ...]) -> dict[str, Any]:
    """Return acceptance against the turn from A4C: one heart, so no interval is given."""
    hits, sure = called.label == labels.index(VIEW), called.probability >= np.float32(SURE)
    away = np.abs(rotation.angle)
    angle = np.where(rotation.angle < 180.0, rotation.angle, -180.0)  # the same turn, in a bin

    def summed(inside: np.ndarray) -> dict[str, Any]:
        told: dict[str, Any] = {"frames": int(inside.sum())}
        if inside.any():
            told["turns"] = len(np.unique(rotation.turn[inside]))
            told["called_a4c"] = float(hits[inside].mean())
            told["surely_a4c"] = float(sure[inside].mean())
            told["probability"] = float(called.probability[inside].mean())
        return told

    ends = np.arange(-180.0, 180.0, BIN)
    bins = [
        {"from": low, "to": low + BIN} | summed((angle >= low) & (angle < low + BIN))
        for low in ends.tolist()
    ]
    sectors = {
        name: {"from": low, "to": high} | summed((away >= low) & (away <= high))
        for name, (low, high) in SECTORS.items()
    }
    counts = {"patients": 1, "turns": len(np.unique(rotation.turn)), "frames": len(hits)}
    return counts | {"called": _counted(called.label, labels), "sectors": sectors, "bins": bins}
