"""A mapping proposed from a folder: which table, which columns, which units, which images."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.sources.table.inputs import Folder
from racines_data.sources.table.mapping import check_mapping
from racines_data.sources.table.propose import columns as names
from racines_data.sources.table.propose.columns import Guess, guess_columns
from racines_data.sources.table.propose.pictures import guess_images
from racines_data.sources.table.rows import ENDINGS, has_commas, read_table
from racines_data.sources.table.sweeps import read_drafts
from racines_data.views import LABELS, VIEWS

_DOWN = 0.3
_REACH = 2.0  # m: of a robot's arm
SEGMENTS = 5


def guess_mapping(folder: Folder) -> Guess:
    """Return the document of a mapping and why its fields are as they are.

    Raises:
        RacinesError: no table with poses in the folder, by what the tables have.
    """
    found = folder.walk()
    path, table, guess, others = _best_table(folder, found)
    parts, notes = guess.parts, guess.notes
    poses: dict[str, Any] = {"file": folder.name(path)}
    if "decimal_comma" in parts:
        poses["decimal_comma"] = parts["decimal_comma"]
    if others > 1:
        poses["file"] = folder.name(path.with_name(f"*{path.suffix}"))
        notes["poses.file"] = f"{others} tables with the same columns: one a sweep"
    sweep = _column(table, names.SWEEPS)
    if sweep is not None:
        poses["sweep"] = sweep
    poses |= {key: parts[key] for key in ("time", "position", "rotation") if key in parts}
    made: dict[str, Any] = {"frame": "tracker", "poses": poses}
    if "forces" in parts:
        made["forces"] = parts["forces"]
    if labels := _labels(table, notes):
        made["labels"] = labels
    sweeps = [path.stem for path in folder.match(poses["file"], "poses.file")]
    if sweep is not None:
        sweeps = table[sweep].cast(pl.String).unique(maintain_order=True).to_list()
    images, notes["images.path"] = guess_images(folder, found, table, sweeps)
    made["images"] = {"path": images or "NOT FOUND"}
    if len(sweeps) < 3:
        made["segments"] = SEGMENTS
        notes["segments"] = f"{len(sweeps)} sweep(s): cut, so that there are splits"
    _frame(folder, made, notes)
    return Guess(made, notes)


def _best_table(folder: Folder, found: Sequence[Path]) -> tuple[Path, pl.DataFrame, Guess, int]:
    """Return the table with most of a pose, its guess, and how many have its columns."""
    best: tuple[int, Path, pl.DataFrame, Guess] | None = None
    alike: dict[tuple[Any, ...], int] = defaultdict(int)
    read, told = {}, []
    for path in found:
        if path.suffix.lower() not in ENDINGS:
            continue
        try:
            table = read_table(path)
            comma = has_commas(table)
            table = read_table(path, comma=True) if comma else table
        except RacinesError as error:
            told.append(str(error))
            continue
        key = path.parent, path.suffix, tuple(table.columns)
        alike[key] += 1
        if alike[key] > 1:
            continue
        guess = guess_columns(table)
        if comma:
            guess.parts["decimal_comma"] = True
            guess.notes["poses.decimal_comma"] = "numbers are written 1,5"
        rotation = guess.parts.get("rotation", {})
        whole = rotation.get("unit") in ("m", "cm", "mm")
        score = 4 * ("position" in guess.parts or whole) + 2 * bool(rotation)
        score += "column" in guess.parts["time"]
        read[path] = key
        if best is None or score > best[0]:
            best = score, path, table, guess
    if best is None or best[0] < 4:
        columns = f"; the best has {', '.join(best[2].columns[:12])}" if best else ""
        said = f"; {told[0]}" if told else ""
        raise RacinesError(
            f"{folder.root}: no table of poses found (x, y, z and a rotation, or a matrix)"
            f"{columns}{said}; write the mapping by hand: docs/table.md"
        )
    return best[1], best[2], best[3], alike[read[best[1]]]


def _column(table: pl.DataFrame, words: Sequence[str]) -> str | None:
    """Return the column of one of these names that has fewer values than rows."""
    bare = {name.lower().strip(): name for name in table.columns}
    for word in words:
        for name in (word, f"{word}_id", f"{word}_name"):
            if name in bare and table[bare[name]].n_unique() <= max(1, len(table) // 2):
                return bare[name]
    return None


def _labels(table: pl.DataFrame, notes: dict[str, str]) -> dict[str, Any]:
    labels: dict[str, Any] = {}
    for key, words in (("view", names.VIEWS), ("target_view", names.TARGETS)):
        name = _column(table, words)
        if name is not None and table.schema[name] == pl.String:
            labels[key] = name
    for key, words in (("grade", names.GRADES), ("session", names.SESSIONS)):
        name = _column(table, words)
        if name is not None and (key == "session" or table.schema[name].is_numeric()):
            labels[key] = name
    said = {
        text
        for key in ("view", "target_view")
        if key in labels
        for text in table[labels[key]].drop_nulls().unique().to_list()
    } - {"", LABELS[-1]}
    if said - set(VIEWS):
        labels["views"] = sorted(said)
        notes["labels.views"] = "what stands in the column"
    return labels


def _frame(folder: Folder, made: dict[str, Any], notes: dict[str, str]) -> None:
    """Tell a robot's frame by a beam that looks down within an arm's reach."""
    try:
        drafts = read_drafts(folder, check_mapping(made, "the guess"))
    except RacinesError:
        return  # what is missing is told when the mapping is checked
    poses = np.concatenate([draft.poses for draft in drafts])
    poses = poses[np.isfinite(poses).all((1, 2))]
    if not len(poses):
        return
    reach = float(np.linalg.norm(poses[:, :3, 3], axis=1).max())
    down = float((poses[:, 2, 2] < -_DOWN).mean())
    if reach <= _REACH and down >= 0.9:
        made["frame"] = "robot"
    notes["frame"] = f"within {reach:.3g} m, the beam looks down in {down:.0%} of the rows"
