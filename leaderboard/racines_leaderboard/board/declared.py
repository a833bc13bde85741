"""What a submission declares of its training, as boards show it: budget, hours and seeds.

Declared, not measured: nothing ranks by it. Seeds of trainings that the record itself keeps are the
record's.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

Record = dict[str, Any]
FIGURES = {"images": "Images", "steps": "Steps", "hours": "Hours"}
"""Numbers of `training`, of one training each, by their heads."""
SEEDS = "Training seeds"
NONE = "–"


def declared(record: Record) -> dict[str, Any]:
    """Return `seeds`, and `budget`, `hardware`, `images`, `steps` and `hours` as far as declared.

    Empty of what is not trained, and of what nobody submitted.
    """
    submission, scores = record.get("submission"), record["scores"]
    if not submission or not scores.get("trained"):
        return {}
    return {"seeds": _seeds(scores, submission), **submission.get("training", {})}


def _seeds(scores: dict[str, Any], submission: dict[str, Any]) -> list[int]:
    """Return the seeds of the trainings: those that the record keeps, or else those declared.

    Weights of further seeds lie in folders of their seeds, beside those of the first.
    """
    if scores.get("trainings"):
        return [each["seed"] for each in scores["trainings"]]
    weights = scores.get("weights") or {}
    further = {int(found[1]) for name in weights if (found := re.match(r"seed-(\d+)/", name))}
    return sorted({*submission.get("seeds", ()), *further})


def declared_columns(records: Sequence[Record]) -> list[tuple[str, list[str]]]:
    """Return head and cells of each column that any of the records fills."""
    told = [declared(record) for record in records]
    columns = [(SEEDS, [", ".join(map(str, each.get("seeds", ()))) or NONE for each in told])]
    for key, head in FIGURES.items():
        columns.append((head, [f"{each[key]:,}" if key in each else NONE for each in told]))
    return [(head, cells) for head, cells in columns if {*cells} != {NONE}]


CSV_DECLARED = tuple(f"training_{key}" for key in ("seeds", *FIGURES))
"""Heads of the same columns in a CSV file."""


def declared_cells(record: Record) -> tuple[Any, ...]:
    """Return what stands in a record's line of `CSV_DECLARED`: figures as numbers."""
    told = declared(record)
    seeds = " ".join(map(str, told.get("seeds", ()))) or None
    return (seeds, *(told.get(key) for key in FIGURES))


def declared_note(records: Sequence[Record]) -> str:
    """Return the budgets in the words of those who submitted; empty where nobody said one."""
    names: dict[str, list[str]] = defaultdict(list)
    for record in records:
        if budget := declared(record).get("budget"):
            names[budget].append(record["name"])
    said = "; ".join(f"{', '.join(each)}: {budget}" for budget, each in names.items())
    return f"Training as declared, which nothing ranks by. {said}." if said else ""
