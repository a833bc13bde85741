"""What a card draws and counts, and its tables: from a training store that is not yet sealed.

The figures are those of the twelve parameters, and shares of classes and grades by split.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from racines_data.card.columns import unit_of
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import (
    METADATA,
    MULTI_PHANTOM,
    added_configs,
    manifest_labels,
    scale_known,
)
from racines_data.records import PIXELS
from racines_data.schema import PARAMETERS, SPLITS
from racines_data.sources.base import manifest_card
from racines_data.tables import code, markdown_table
from racines_data.views import LABELS, PAPER_STATISTICS, VIEW_TITLES

CACTUS_COUNTS = {"A4C": 7422, "SC": 6345, "PL": 6102, "PSAV": 5832, "PSMV": 6014, "Random": 6021}
"""Images of each class in CACTUS (DOI 10.20383/103.01484), recorded on the same kind of block."""

GRADE_EDGES = np.array([0.0, *np.arange(0.5, 10.0), 10.001])
"""Bins of grades: half a grade to each side of 0, 1, … 10."""


def has_paper(manifest: Mapping[str, Any]) -> bool:
    """Return whether the paper's statistics are the measure of this dataset: a heart with poses."""
    return manifest_card(manifest).like_paper and manifest_labels(manifest) == LABELS


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
    patients: list[int] | None = None
    """Seed of each trajectory's patient, where patients are scanned."""
    masks: np.ndarray | None = None
    """(N, 128, 128) uint8 labels, where frames have masks."""
    scaled: bool = True
    """Whether positions are in metres; else they are in pixels."""

    def rows_of(self, trajectory: int) -> slice:
        """Return the rows of one trajectory; they are neighbours."""
        low, high = np.searchsorted(self.trajectory, (trajectory, trajectory + 1))
        return slice(int(low), int(high))


def read_frames(path: Path, manifest: Mapping[str, Any]) -> Frames:
    """Map a store by its path, whatever the manifest says of its files."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    named = json.loads(table.schema.metadata[METADATA])
    target_views = list(named["trajectories"][2])
    masks = _pixels(table, "mask") if "mask" in table.column_names else None
    parameters = table["parameters"].chunk(0).flatten().to_numpy()
    return Frames(
        images=_pixels(table, "image"),
        parameters=parameters.reshape(-1, len(PARAMETERS)),
        views=table["view"].to_numpy(),
        grades=table["grade"].to_numpy(),
        timestamps=table["timestamp"].to_numpy(),
        trajectory=table["trajectory"].to_numpy(),
        target_views=target_views,
        phantoms=list(named.get("phantoms") or [None] * len(target_views)),
        splits={name: tuple(named["splits"][name]) for name in SPLITS if name in named["splits"]},
        labels=manifest_labels(manifest),
        patients=named.get("patients"),
        masks=masks,
        scaled=scale_known(manifest),
    )


def _pixels(table: pa.Table, column: str) -> np.ndarray:
    pixels = np.frombuffer(table[column].chunk(0).buffers()[1], np.uint8, len(table) * PIXELS)
    return pixels.reshape(-1, IMAGE_SIZE, IMAGE_SIZE)


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


def number(value: float, digits: int = 4) -> str:
    """Return a number with a fixed number of digits and a true minus, none before zero."""
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if not float(text) else "−")


def splits_table(manifest: Mapping[str, Any]) -> str:
    """Return trajectories and frames of each split, of `multi_phantom` too."""
    rows = [
        ("frames", split, f"{count['trajectories']:,}", f"{count['frames']:,}")
        for split, count in manifest["counts"]["splits"].items()
    ]
    many = manifest.get(MULTI_PHANTOM)
    for split, count in (many or {}).get("splits", {}).items():
        told = f"{count['trajectories']:,} ({count['hearts']} hearts)"
        rows.append((MULTI_PHANTOM, split, told, f"{count['frames']:,}"))
    for name in added_configs(manifest):
        for split, count in manifest[name]["counts"]["splits"].items():
            told = f"{count['trajectories']:,} ({count['patients']} patients)"
            rows.append((name, split, told, f"{count['frames']:,}"))
    return markdown_table(("config", "split", "trajectories", "frames"), rows, right=2)


def statistics_table(manifest: Mapping[str, Any]) -> str:
    """Return the twelve parameters, with the paper's beside them where they are the measure."""
    kinds, paper, rows = ("minimum", "maximum", "mean", "std"), has_paper(manifest), []
    for name, ours in manifest["statistics"]["parameters"].items():
        cells = [number(ours[kind]) for kind in kinds]
        if paper:
            known = PAPER_STATISTICS[name]
            theirs = (number(getattr(known, kind)) for kind in kinds)
            cells = [" / ".join(pair) for pair in zip(cells, theirs, strict=True)]
            cells.append(number((ours["mean"] - known.mean) / known.std, 2))
            cells.append(number(ours["std"] / known.std, 2))
        rows.append((code(name), unit_of(name, scale_known(manifest)), *cells))
    head = ("parameter", "unit", "min", "max", "mean", "std")
    beside = ("Δ mean, paper's std", "std ratio") if paper else ()
    return markdown_table((*head, *beside), rows, right=2)


def classes_table(manifest: Mapping[str, Any]) -> str:
    """Return frames of each class by split, their share, and that of CACTUS for the heart."""
    labels = manifest_labels(manifest)
    found = manifest["statistics"]["views"]
    views = {split: found[split] for split in SPLITS if split in found}
    cactus = CACTUS_COUNTS if labels == tuple(CACTUS_COUNTS) else {}
    whole = sum(counts[name] for counts in views.values() for name in labels)
    rows = []
    for name in labels:
        counts = [each[name] for each in views.values()]
        row = [f"{name}: {VIEW_TITLES[name]}" if name in VIEW_TITLES else name]
        row += [f"{count:,}" for count in counts]
        row.append(f"{100.0 * sum(counts) / whole:.1f} %")
        if cactus:
            row.append(f"{100.0 * cactus[name] / sum(cactus.values()):.1f} %")
        rows.append(row)
    unknown = [counts["unknown"] for counts in views.values()]
    if any(unknown):
        rows.append(["unknown", *(f"{n:,}" for n in unknown), "", *[""] * bool(cactus)])
    head = ("class", *views, "share", *["CACTUS"] * bool(cactus))
    return markdown_table(head, rows, right=1)


def grades_table(manifest: Mapping[str, Any]) -> str:
    """Return the share of each rounded grade among the graded frames of a view, by split."""
    rows = []
    for split, found in manifest["statistics"]["grades"].items():
        total = sum(found["counts"])
        if total:
            rows.append((split, *(f"{100.0 * n / total:.1f}" for n in found["counts"])))
    return markdown_table(("grade, %", *(str(grade) for grade in range(11))), rows, right=1)
