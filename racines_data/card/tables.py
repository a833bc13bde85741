"""Tables of a card in Markdown."""

from collections.abc import Mapping
from typing import Any

from racines_data.card.frames import CACTUS_COUNTS, has_paper, unit_of
from racines_data.manifest import MULTI_PHANTOM, manifest_labels
from racines_data.schema import SPLITS
from racines_data.tables import Markdown, code, markdown_table
from racines_data.views import PAPER_STATISTICS, VIEW_TITLES

COLUMNS = (
    ("image", "PNG, 8-bit gray", "", "128×128; beam axis down, probe at the top centre"),
    ("force_x, force_y, force_z", "float32", "N", "force at the wrist sensor; null if unmeasured"),
    ("torque_x, torque_y, torque_z", "float32", "N·m", "torque there; null if unmeasured"),
    ("position_x, position_y, position_z", "float32", "m", "probe's tip, robot base frame"),
    ("rotation_x, rotation_y, rotation_z", "float32", "rad", "extrinsic xyz Euler angles"),
    ("timestamp", "float64", "s", "increases along a trajectory"),
    ("control_x, control_y, control_z", "float32", "m/s", "commanded velocity; null if unknown"),
    ("control_rx, control_ry, control_rz", "float32", "rad/s", "commanded rate; null if unknown"),
    ("view", "label", "", "what the frame shows; null if unknown"),
    ("grade", "float32", "", "quality of the view, 1–10, 0 where there is none; null if unknown"),
    ("view_predicted", "label", "", "a grader's opinion; null until annotated"),
    ("grade_predicted", "float32", "", "a grader's opinion; null until annotated"),
    ("target_view", "string", "", "what the sweep aimed at; Random for nothing"),
    ("phantom", "int32", "", "seed of the simulated anatomy, 0 the canonical; null if recorded"),
    ("source", "label", "", "where the frame comes from"),
    ("session", "string", "", "recording session; in `multi_phantom` the heart"),
    ("trajectory", "string", "", "sweep; wholly in one split"),
    ("frame", "int32", "", "number of the frame in its trajectory, from 0"),
)
"""Name, type, unit and meaning of the columns of `frames`."""


def number(value: float, digits: int = 4) -> str:
    """Return a number with a fixed number of digits and a true minus, none before zero."""
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if not float(text) else "−")


def columns_table() -> str:
    """Return the columns of `frames`."""
    rows = [(Markdown(f"`{names}`".replace(", ", "`, `")), *about) for names, *about in COLUMNS]
    return markdown_table(("column", "type", "unit", "meaning"), rows)


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
        rows.append((code(name), unit_of(name), *cells))
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
