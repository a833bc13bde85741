"""Tables of a card in Markdown."""

from collections.abc import Mapping
from typing import Any

from racines_data.card.statistics import CACTUS_COUNTS, has_paper, unit_of
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
    names = (", ".join(f"`{name}`" for name in row[0].split(", ")) for row in COLUMNS)
    rows = ((Markdown(name), *row[1:]) for name, row in zip(names, COLUMNS, strict=True))
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
    ours = manifest["statistics"]["parameters"]
    kinds = ("minimum", "maximum", "mean", "std")
    if not has_paper(manifest):
        rows = [
            (code(k), unit_of(k), *(number(v[kind]) for kind in kinds)) for k, v in ours.items()
        ]
        return markdown_table(("parameter", "unit", "min", "max", "mean", "std"), rows, right=2)
    rows = []
    for name, values in ours.items():
        paper = PAPER_STATISTICS[name]
        pairs = (f"{number(values[kind])} / {number(getattr(paper, kind))}" for kind in kinds)
        shift = number((values["mean"] - paper.mean) / paper.std, 2)
        ratio = number(values["std"] / paper.std, 2)
        rows.append((code(name), unit_of(name), *pairs, shift, ratio))
    head = ("parameter", "unit", "min", "max", "mean", "std", "Δ mean, paper's std", "std ratio")
    return markdown_table(head, rows, right=2)


def classes_table(manifest: Mapping[str, Any]) -> str:
    """Return frames of each class by split, their share, and that of CACTUS for the heart."""
    views, labels = manifest["statistics"]["views"], manifest_labels(manifest)
    cactus = CACTUS_COUNTS if labels == tuple(CACTUS_COUNTS) else {}
    whole = sum(views[split][name] for split in views for name in labels)
    rows = []
    for name in labels:
        counts = [views[split][name] for split in SPLITS if split in views]
        row = [f"{name}: {VIEW_TITLES[name]}" if name in VIEW_TITLES else name]
        row += [f"{count:,}" for count in counts]
        row.append(f"{100.0 * sum(counts) / whole:.1f} %")
        if cactus:
            row.append(f"{100.0 * cactus[name] / sum(cactus.values()):.1f} %")
        rows.append(row)
    unknown = [views[split]["unknown"] for split in SPLITS if split in views]
    if any(unknown):
        rows.append(["unknown", *(f"{n:,}" for n in unknown), "", *([""] if cactus else [])])
    head = ("class", *(split for split in SPLITS if split in views), "share")
    return markdown_table((*head, "CACTUS") if cactus else head, rows, right=1)


def grades_table(manifest: Mapping[str, Any]) -> str:
    """Return the share of each rounded grade among the graded frames of a view, by split."""
    rows = []
    for split, found in manifest["statistics"]["grades"].items():
        total = sum(found["counts"])
        if total:
            rows.append((split, *(f"{100.0 * n / total:.1f}" for n in found["counts"])))
    return markdown_table(("grade, %", *(str(grade) for grade in range(11))), rows, right=1)
