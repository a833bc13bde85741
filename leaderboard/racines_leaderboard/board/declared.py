"""What a submission declares of its training, as boards show it: budget, hours and seeds.

Nothing ranks by it. Figures that nobody declared are those that the run tells, where its weights
lie here. Seeds of trainings that the record itself keeps are the record's.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from racines_leaderboard.board.trained import trained_as

Record = dict[str, Any]
FIGURES = {"images": "Images", "steps": "Steps", "hours": "Hours"}
"""Numbers of `training`, of one training each, by their heads."""
SEEDS = "Training seeds"
NONE = "–"


def declared(record: Record) -> dict[str, Any]:
    """Return `seeds`, and `budget`, `hardware`, `images`, `steps` and `hours` as far as declared.

    Figures that are not declared are those of the run. Empty of what is not trained; of what
    nobody submitted, those alone.
    """
    submission, scores = record.get("submission"), record["scores"]
    if not scores.get("trained"):
        return {}
    said = (
        {"seeds": _seeds(scores, submission), **submission.get("training", {})}
        if submission
        else {}
    )
    return _told_by_run(record) | said


def _told_by_run(record: Record) -> dict[str, Any]:
    """Return the figures of a record's run, hours to two digits."""
    told = trained_as(record)
    return {key: float(f"{each:.2g}") if key == "hours" else each for key, each in told.items()}


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
    run = any(_told_by_run(each) for each in records if each["scores"].get("trained"))
    told = "Training as declared, or else as the first run tells" if run else "Training as declared"
    return f"{told}, which nothing ranks by. {said}." if said else ""
