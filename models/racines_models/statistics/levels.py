"""The level that an interval is printed with: 0.95, or the coverage measured where that is less.

`coverage.json` beside this module is written by `racines study coverage --table`. It has, by kind
of interval, the share of simulated studies of some sizes whose interval held the value.
"""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

TABLE = Path(__file__).with_name("coverage.json")
KEPT = 0.93
"""An interval that covers so often or more is printed with its nominal level."""


def nominal(kind: str, units: int, trainings: int) -> float | None:
    """Return the level of an interval of a kind of so many units and trainings.

    None where nothing was measured: there is no table.

    What was measured of the largest studies that are no larger counts, below the smallest that of
    those; of several trainings, what was measured of several.

    Raises:
        KeyError: a kind that was not studied.
    """
    table = _table()
    if table is None:
        return None
    rows = table["coverage"][kind]
    most = max(row["trainings"] for row in rows)
    rows = [row for row in rows if row["trainings"] == (1 if trainings < 2 else most)]
    fitting = [row for row in rows if row["units"] <= units]
    row = max(fitting, key=_units) if fitting else min(rows, key=_units)
    return table["nominal"] if row["coverage"] >= KEPT else round(row["coverage"], 2)


def _units(row: dict[str, Any]) -> int:
    return row["units"]


@lru_cache(maxsize=1)
def _table() -> dict[str, Any] | None:
    return json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.is_file() else None
