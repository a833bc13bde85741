"""What the documentation says of what generators draw, beside real frames.

racines study sim-to-real scout-field scout-attention nearest-pose --real FILE.parquet --out camus
racines study sim-to-real scout-field scout-attention nearest-pose --real DATASET --out turned
python -m tests.models.studies.drawn_figures camus.json turned.json
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_models.studies.sim_to_real.drawn import SIMULATOR
from tests.models.studies.judged import LISTS, RESULTS

SETS = *LISTS, "imported"
TITLES = {
    "tuning": "A4C, tuning patients",
    "reporting": "A4C, reporting patients",
    "imported": "one heart turned about the apex",
}
DRAWN = {
    SIMULATOR: "the simulator itself",
    "nearest-pose": "nearest-pose of the scout",
    "scout-field": "scout-field",
    "scout-attention": "scout-attention",
}


def interval(told: dict[str, Any]) -> str:
    """Return a figure and its interval."""
    value, low, high = (f"{told[key]:.3f}" for key in ("value", "low", "high"))
    return f"{value} ({low} – {high})"


def table(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Return KID to each set of real frames, a row for each who draws."""
    kid: dict[str, dict[str, Any]] = {}
    for report in reports:
        for name, sets in report["drawn"]["kid"].items():
            kid.setdefault(name, {}).update(sets)
    rows = []
    for name, title in DRAWN.items():
        sets = kid[name]
        trainings = sets[SETS[0]]["settings"]["trainings"]
        learned = str(trainings) if trainings > 1 else "–"
        rows.append([title, learned, *(interval(sets[each]) for each in SETS)])
    return {"columns": ["drawn by", "trainings", *(TITLES[each] for each in SETS)], "rows": rows}


def main(paths: list[str]) -> None:
    """Write the table and what was drawn of whom."""
    reports = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
    content = json.loads((RESULTS / "sim-to-real.json").read_text())
    content["tables"]["drawn"] = table(reports)
    told = reports[0]["drawn"]
    content["figures"]["of_generators"] = {"frames": told["n"], "patients": told["patients"]}
    write_json(RESULTS / "sim-to-real.json", content)


if __name__ == "__main__":
    main(sys.argv[1:])
